"""The boat's program."""
