"""The paper's closed loop and its regression on its own model."""
