"""From logs to a model of the boat: one engine, identification, diagnosis, validation, excitation."""
