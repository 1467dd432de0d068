"""UWB ranges and positions in the filter, and the place of a tag from ranges alone."""
