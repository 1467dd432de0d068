"""Whether the boat does what it is told, and which sensor or thruster does not: pure tests on what is known anyway."""
