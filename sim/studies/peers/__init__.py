"""The problem of the structured fit written for scipy with CasADi, to compare times."""
