"""Research: may import everything, and nothing of the product imports it."""
