"""Diagnosis: what a vessel file gets wrong about logs, which causes explain it, and the gain of a file with them.

Method: docs/diagnose.md.
"""
