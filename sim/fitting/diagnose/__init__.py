"""What does the simulation get wrong, why, and what is gained by mending it: method in docs/diagnose.md."""
