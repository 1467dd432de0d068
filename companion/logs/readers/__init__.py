"""Readers of logs into `Run`: MCAP, CSV, Parquet, ArduPilot .BIN and .tlog, C/S Enterprise I, UWB text."""
