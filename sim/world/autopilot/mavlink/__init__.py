"""The simulated autopilot's side of MAVLink: peers, commands, streams, files, logs, signing."""
