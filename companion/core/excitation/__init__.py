"""Excitation: manoeuvres that make a boat's parameters visible, flown inside the fence. Reference: docs/excite.md."""
