"""The autopilot and the UWB tag as the event loop uses them: what goes out to them, and when."""
