"""Sensors against each other, against the motion, and against what no boat does."""
