"""Excitation flown in the simulated world, what it would tell of each parameter, and which manoeuvre to fly next."""
