"""The ground of all fits: windows, noise, parameters, trajectories with exact Jacobians, the smoother."""
