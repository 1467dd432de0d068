"""Signs and sides before any fit: are heading, gyro, accelerations, positions and thrusters connected as the file says?

Method: docs/wiring.md.
"""
