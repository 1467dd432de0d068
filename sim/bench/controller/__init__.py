"""The controller beside the solvers that a user could pick, on the same recorded states."""
