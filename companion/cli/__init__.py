"""The command line: one module a command; `add_parser` says what it takes, its function does it."""
