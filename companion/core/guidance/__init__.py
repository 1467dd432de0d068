"""Guidance: paths, rounded courses, LOS and ILOS, speed profile, station keeping."""
