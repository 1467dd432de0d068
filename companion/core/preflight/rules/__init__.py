"""Rules that judge an autopilot's parameters: each yields rows for (parameters, wiring, companion)."""
