"""The real-time iteration: Gauss-Newton steps by Riccati recursion, for any optimal control problem of one stage."""
