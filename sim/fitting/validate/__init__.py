"""Held-out logs against models: open loop with the same commands, side by side with what needs no model."""
