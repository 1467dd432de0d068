"""A simulated autopilot on a stepped clock with any number of MAVLink peers, for the tests beside it."""

from __future__ import annotations

from collections import defaultdict

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot import AT_REST, BOAT_PARAMETERS, Rover

S = 1_000_000_000
MS = 1_000_000
NEUTRAL = [1500] * 4 + [65535] * 4 + [0] * 10
"""An override that holds channels 1-4 in neutral and leaves the others alone."""


def override(low=1500, high=0):
    """Channels 1-4 at `low`, 5-8 left alone, 9-12 at `high` (one value or four), the rest ignored."""
    nine_to_twelve = list(high) if isinstance(high, (list, tuple)) else [high] * 4
    values = [low] * 4 + [65535] * 4 + nine_to_twelve + [0] * 6
    return wire.MAVLink_rc_channels_override_message(0, 0, *values)


def command(number, *params):
    values = [float(p) for p in params] + [0.0] * (7 - len(params))
    return wire.MAVLink_command_long_message(1, 1, number, 0, *values)


class Bench:
    """`got[peer]`: messages received in order. The clock starts at an odd instant on purpose.

    `rover`: further arguments of the Rover (`firmware`, `serial_of`, ...).
    """

    def __init__(self, changes=None, base=BOAT_PARAMETERS, drift_ppm=0.0, dt_s=0.01, sensors=AT_REST, **rover):
        self.boot_ns = 123_456_789
        self.t_ns = self.boot_ns
        self.dt_ns = round(dt_s * S)
        self.sensors = sensors
        self.rover = Rover(self.boot_ns, {**base, **(changes or {})}, drift_ppm, **rover)
        self.got = defaultdict(list)
        self.sent = defaultdict(bytearray)
        self.senders = {}
        self._parsers = {}

    def join(self, peer, system=1, component=191):
        self.senders[peer] = wire.MAVLink(None, system, component)
        self._parsers[peer] = wire.MAVLink(None)
        self.rover.add_link(peer)

    def send(self, message, peer="boat"):
        """Hand a message to the autopilot now; returns what it answered at once."""
        if peer not in self.senders:
            self.join(peer)
        sender = self.senders[peer]
        data = message.pack(sender)
        sender.seq = (sender.seq + 1) % 256
        return self._take(peer, self.rover.receive(data, peer, self.t_ns))

    def receiver(self, *sticks_us):
        """An RC receiver with these channels from now on; none without arguments."""
        self.sensors = msgspec.structs.replace(self.sensors, receiver_us=sticks_us)

    def run(self, seconds, every=None, period_s=0.1):
        """Step for a while; `every`: messages to send each period. Returns what peer "boat" got."""
        before = len(self.got["boat"])
        end_ns = self.t_ns + round(seconds * S)
        next_ns = self.t_ns
        while self.t_ns < end_ns:
            if every is not None and self.t_ns >= next_ns:
                self.send(every)
                next_ns += round(period_s * S)
            self.t_ns = min(self.t_ns + self.dt_ns, end_ns)
            for peer, data in self.rover.step(self.t_ns, self.sensors):
                self._take(peer, data)
        return self.got["boat"][before:]

    def until(self, condition, limit_s=5.0):
        """Step until something is true; the time it took [s]. Fails at the limit."""
        start_ns = self.t_ns
        while not condition():
            assert self.t_ns - start_ns < limit_s * S, "it never happened"
            self.run(self.dt_ns / S)
        return (self.t_ns - start_ns) / S

    def ready(self):
        """Past start-up, with RC input, in MANUAL and armed."""
        self.run(1.2, every=override())
        assert self.ack(command(176, 1, 0)) == 0
        assert self.ack(command(400, 1)) == 0
        return self

    def ack(self, message, peer="boat"):
        """Result of the first COMMAND_ACK that answers."""
        return next(m.result for m in self.send(message, peer) if m.get_type() == "COMMAND_ACK")

    def out(self, number):
        return self.rover.outputs_us[number - 1]

    def _take(self, peer, data):
        self.sent[peer] += data
        messages = self._parsers[peer].parse_buffer(data) or []
        self.got[peer] += messages
        return messages


def of_type(messages, name):
    return [m for m in messages if m.get_type() == name]


def texts(messages):
    """STATUSTEXTs with their chunks joined: [(severity, text)]."""
    joined = []
    for m in of_type(messages, "STATUSTEXT"):
        if m.id and m.chunk_seq:
            severity, text = joined.pop()
            joined.append((severity, text + m.text))
        else:
            joined.append((m.severity, m.text))
    return joined
