"""The range-only filter on measured UWB ranges."""
