"""Structured fit: the 3-DOF vessel model and its nuisances from logs, with intervals."""
