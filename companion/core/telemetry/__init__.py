"""What shore is sent and may order: structs, topics, rounding, and the check of signed orders."""
