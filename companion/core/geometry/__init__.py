"""Angles, frames (NED, site, body) and the fence."""
