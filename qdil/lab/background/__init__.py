"""The methods that PPGA grew from, on a problem with exact gradients."""
