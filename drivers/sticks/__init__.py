"""Sticks: what a person's hands do, as shares of the boat's force. Pure, but for reading a gamepad's device."""
