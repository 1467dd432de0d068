"""The 23-term Taylor (Abkowitz) model, fitted beside the structured one: pipeline, regression, file."""
