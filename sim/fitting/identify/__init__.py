"""`aritra identify`: the structured fit, which model to believe, and what is written of it."""
