"""Commands that start a simulated boat: demo, sim, several boats."""
