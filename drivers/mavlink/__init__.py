"""MAVLink: codec, clock offset and session with one ArduPilot autopilot. Sans-I/O."""
