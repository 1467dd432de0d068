"""From pulse widths and volts to thruster forces over whole logs, with their derivatives."""
