"""What it costs: solvers side by side on the same recorded states, in one run."""
