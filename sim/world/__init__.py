"""The simulated world: hull, weather, sensors, autopilot, UWB tag, and the wires between."""
