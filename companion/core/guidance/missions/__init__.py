"""Mission files in four spellings: TOML, GeoJSON, QGroundControl plan, waypoints."""
