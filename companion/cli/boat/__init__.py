"""Commands that talk to a boat: check, provision, run, teleop, replay, and the wires they share."""
