"""Thrusters that do not do what they are told: a bank of hypotheses, the verdict on it, and what is left."""
