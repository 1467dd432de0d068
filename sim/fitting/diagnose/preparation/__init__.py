"""Logs before a diagnosis: columns that were swapped, gaps, and what of a long log is used."""
