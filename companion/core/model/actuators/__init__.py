"""Actuators: one object, one file each, from the pulse widths of its channels to the force on the boat."""
