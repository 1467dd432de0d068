"""Driving by hand from a page: its sticks, signed and sent on."""
