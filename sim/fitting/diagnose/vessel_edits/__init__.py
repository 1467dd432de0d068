"""Causes in the words, units and keys of the vessel file, and the files that are written."""
