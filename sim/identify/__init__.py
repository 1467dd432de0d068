"""From logs to a model: one form of a log (`run`), its readers, and what is fitted to it."""
