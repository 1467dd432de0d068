"""Setting up an autopilot: MAVSDK for parameters and logs, our own file transfer, a relay between them and the port."""
