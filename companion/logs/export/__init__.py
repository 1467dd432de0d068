"""Logs as tables, as GeoJSON, as pictures for screen and print."""
