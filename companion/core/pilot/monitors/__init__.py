"""Monitors: each watches one thing and reports events, conditions and alerts; `table` lists them all."""
