"""From a reference to thruster forces: optimal control problem, solvers, allocation, fallback."""
