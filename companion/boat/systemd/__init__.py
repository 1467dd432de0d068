"""The service manager: what it is told, and the wire to it."""
