"""ArduPilot's JSON physics interface: the simulated boat for a real firmware."""
