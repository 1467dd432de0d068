"""The boat's side of the shore: telemetry out, signed orders in, over zenoh."""
