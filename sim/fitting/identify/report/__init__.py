"""The report on an identification: one self-contained page."""
