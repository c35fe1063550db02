"""The methods that PPGA grew from, on problems with exact gradients."""
