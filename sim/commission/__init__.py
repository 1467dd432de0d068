"""Commissioning: from a first vessel file to one that drives well, stage by stage, by flights designed on the way."""
