"""Commission: from a first guess to a vessel file that drives well, and a watch over it afterwards. Method: docs."""
