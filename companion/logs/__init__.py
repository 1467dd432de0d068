"""Logs: what is in an MCAP file, read, recovered, summarised, replayed."""
