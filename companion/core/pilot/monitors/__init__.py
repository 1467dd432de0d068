"""What watches one thing each: overrides, link latency, battery, stuck sensors."""
