"""The files that describe boat, site and run: typed values, unknown keys refused with file and key."""
