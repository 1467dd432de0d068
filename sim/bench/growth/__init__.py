"""How costs grow with horizon, thrusters, logs and catalogue."""
