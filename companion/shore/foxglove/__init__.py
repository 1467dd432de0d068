"""A boat's telemetry for Foxglove: live, and as a file."""
