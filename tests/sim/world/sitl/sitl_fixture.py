"""Servo packets and units of time for the tests of the JSON protocol."""

import struct

from sim.world.sitl.protocol import PhysicsState

MS = 1_000_000
S = 1000 * MS
AT_REST = PhysicsState(1.0, (0.0,) * 3, (0.0, 0.0, -9.8), (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, 15.6, 1.5)


def packet(count=0, rate=200, pulses=(1500,) * 4, outputs=16):
    magic = {16: 18458, 32: 29569}[outputs]
    return struct.pack(f"<HHI{outputs}H", magic, rate, count, *pulses, *[0] * (outputs - len(pulses)))
