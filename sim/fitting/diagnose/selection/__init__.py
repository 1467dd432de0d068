"""Model selection: candidates by evidence, adequacy of the result, held-out scores, identifiability, manoeuvres."""
