"""One module a command of `aritra`: `add_parser` says what it takes, its function does it."""
