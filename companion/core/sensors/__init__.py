"""One object for each sensor of a vessel file; `table.sensors_of` has those of one boat."""
