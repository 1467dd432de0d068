"""C/S Enterprise I identified from its recordings."""
