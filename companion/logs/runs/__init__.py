"""Run: the common form of all logs, and its preparation for a fit: problems, parts, corrections, decimation."""
