"""Loops over windows, steps and columns that numba compiles."""
