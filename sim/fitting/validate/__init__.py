"""Validation: models and baselines in open loop on held-out logs, under the logged commands; scores and report."""
