"""A watch over a boat that works every day: each mission refines its file, and changes are told."""
