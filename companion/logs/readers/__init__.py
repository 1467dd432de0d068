"""Readers: MCAP, CSV, Parquet, ArduPilot .BIN and .tlog, C/S Enterprise I, UWB text -> Run."""
