"""Missions driven with what was identified or diagnosed."""
