"""The notebooks as a series: their index, execution, pages and made tables."""
