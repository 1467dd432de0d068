"""The simulated world, and how it compares with the measured one."""
