"""The sending sides of the links: what goes out to the autopilot and to the UWB tag."""
