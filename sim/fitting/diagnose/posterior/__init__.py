"""Maximum a posteriori of nodes and effects: physics with any set of effects, columns, evidence."""
