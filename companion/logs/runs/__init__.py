"""Run: one log in one form, whatever it came from, and what is done with it before a fit."""
