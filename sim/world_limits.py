"""Ranges of what a simulated world may be like, of command lines and campaigns alike.

They keep out what no basin has and what the simulator was never meant for; assumed, and generous.
"""

FARTHEST_M, CURRENT_M_S, WIND_M_S, WAVES_M, MISMATCH = 10_000.0, 10.0, 60.0, 10.0, 0.5
"""Largest place, current, wind, significant height of waves, and share that the plant is off its vessel file."""
ANGLE_DEG, TURN_DEG_S = 360.0, 10.0
"""Largest direction, and rate at which a current turns; the same as of the vessel file's terms."""
GUSTINESS, GUST_TIME_S = 2.0, (0.1, 1000.0)
"""Largest share by which wind varies, and shortest and longest time of its gusts; as of the vessel file's term."""
WAVE_PERIOD_S, FAR_READING_M = (0.2, 60.0), 1000.0
"""Shortest and longest peak period of waves; longest extra path of a range without line of sight."""
