"""Inner loops of the fits over windows, steps and columns, compiled by numba."""
