from itertools import pairwise

from pymavlink.dialects.v20 import ardupilotmega as dialect

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.session import MavlinkSession
from tests.drivers.mavlink.mavlink_autopilot import Sender, read_one

MS = 1_000_000
S = 1_000_000_000
RATES = {"ATTITUDE": 50.0, "RAW_IMU": 50.0, "SYS_STATUS": 2.0}
STREAMS = {
    "ATTITUDE": lambda sender, t_ms: sender.att(t_ms),
    "RAW_IMU": lambda sender, t_ms: sender.imu(t_ms * 1000),
    "SYS_STATUS": lambda sender, _: sender.sys_status(0, 0, 0, 0, 16000, 0, 50, 0, 0, 0, 0, 0, 0),
}


class Autopilot:
    """Answers as ArduPilot 4.6 (caps at 80 % of the loop rate) or 4.7 (denies what is above), in 10 ms steps.

    `deaf` requests are lost on the wire.
    """

    def __init__(self, loop_hz: float = 400.0, denies: bool = False, deaf: int = 0, knows_version=True) -> None:
        self.sender = Sender()
        self.loop_hz, self.denies, self.deaf, self.knows_version = loop_hz, denies, deaf, knows_version
        self.boot_ns = -60 * S
        self.rates: dict[str, float] = {}
        self.due: dict[str, float] = {}
        self.heard: list = []
        self.silent = False
        self.parameters: dict[str, float] = {"INS_GYRO_FILTER": 20.0, "INS_ACCEL_FILTER": 10.0}

    def reboot(self, t_ns: int) -> None:
        self.boot_ns, self.rates = t_ns, {}

    def take(self, data: bytes, t_ns: int) -> bytes:
        m = read_one(data)
        self.heard.append((t_ns, m))
        if self.silent:
            return b""
        if m.get_type() == "TIMESYNC" and m.tc1 == 0:
            return self.sender.timesync(t_ns - self.boot_ns, m.ts1)
        if m.get_type() == "COMMAND_LONG" and m.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._set_interval(m, t_ns)
        if m.get_type() == "PARAM_REQUEST_READ" and m.param_id in self.parameters:
            return self.sender.param_value(m.param_id.encode(), self.parameters[m.param_id], 9, 300, 7)
        if m.get_type() == "COMMAND_LONG" and m.param1 == 148 and self.knows_version:
            zeros = [0] * 8
            return self.sender.autopilot_version(0, 1, 0, 0, 140, zeros, zeros, zeros, 0, 0, 0)
        return b""

    def _set_interval(self, m, t_ns: int) -> bytes:
        if self.deaf:
            self.deaf -= 1
            return b""
        name = dialect.mavlink_map[int(m.param1)].msgname
        rate_hz, limit_hz = 1e6 / m.param2, 0.8 * self.loop_hz
        if self.denies and rate_hz > limit_hz * 1.001:
            return self.sender.command_ack(m.command, 2)
        self.rates[name], self.due[name] = min(rate_hz, limit_hz), t_ns
        return self.sender.command_ack(m.command, 0)

    def step(self, t_ns: int) -> bytes:
        if self.silent:
            return b""
        out = b""
        if t_ns % S == 0:
            out += self.sender.beat()
        for name, rate_hz in self.rates.items():
            while self.due[name] <= t_ns:
                out += STREAMS[name](self.sender, (t_ns - self.boot_ns) // MS)
                self.due[name] += S / rate_hz
        return out


class Talk:
    """Codec, session and autopilot, 10 ms at a time; delay of one step each way."""

    def __init__(self, autopilot: Autopilot, start_ns: int = 0) -> None:
        self.autopilot, self.t_ns = autopilot, start_ns
        self.codec = MavlinkCodec()
        self.session = MavlinkSession(self.codec, RATES)
        self.alerts: list[str] = []
        self._incoming = b""

    def run(self, seconds: float) -> "Talk":
        for _ in range(round(seconds * 100)):
            messages = self.codec.feed(self._incoming, self.t_ns)
            self._incoming = self.autopilot.step(self.t_ns)
            for data in self.session.step(messages, self.t_ns):
                self._incoming += self.autopilot.take(data, self.t_ns)
            self.alerts += [a.text for a in self.session.take_alerts()]
            self.t_ns += 10 * MS
        return self

    def heard(self, kind: str, command: int | None = None) -> list:
        return [
            (t, m)
            for t, m in self.autopilot.heard
            if m.get_type() == kind and (command is None or m.command == command)
        ]

    def intervals(self, name: str) -> list[tuple[float, float]]:
        """(time [s], rate [Hz]) of every request for message type `name`."""
        return [
            (t / S, round(1e6 / m.param2, 3))
            for t, m in self.heard("COMMAND_LONG", dialect.MAV_CMD_SET_MESSAGE_INTERVAL)
            if dialect.mavlink_map[int(m.param1)].msgname == name
        ]


def test_good_autopilot_is_asked_once_and_kept_in_step():
    talk = Talk(Autopilot()).run(30)
    assert len(talk.heard("HEARTBEAT")) == 30
    assert len(talk.heard("TIMESYNC")) in (119, 120)
    assert len(talk.heard("COMMAND_LONG", 512)) == 1
    assert talk.session.autopilot is not None
    assert talk.session.autopilot.board_version == 140
    for name, rate_hz in RATES.items():
        assert [rate for _, rate in talk.intervals(name)] == [rate_hz]
        assert abs(talk.codec.counters.received[name] - 30 * rate_hz) <= 2
    assert talk.alerts == []
    assert talk.codec.clock.offset_ns is not None
    assert abs(talk.codec.clock.offset_ns - (-60 * S)) <= 5 * MS  # half of the 10 ms round trip


def test_nothing_but_heartbeats_before_the_autopilot_is_heard():
    autopilot = Autopilot()
    autopilot.silent = True
    talk = Talk(autopilot).run(5)
    assert {m.get_type() for _, m in autopilot.heard} == {"HEARTBEAT"}
    autopilot.silent = False
    talk.run(2)
    assert talk.intervals("ATTITUDE")


def test_lost_requests_are_repeated_without_a_warning():
    talk = Talk(Autopilot(deaf=3)).run(12)
    assert [rate for _, rate in talk.intervals("ATTITUDE")] == [50, 50]
    assert talk.alerts == []
    assert talk.codec.counters.received["ATTITUDE"] > 8 * 50


def test_slow_loop_that_denies_ends_at_its_80_percent_with_a_warning():
    """Rover 4.7 at the default SCHED_LOOP_RATE of 50 Hz."""
    talk = Talk(Autopilot(loop_hz=50, denies=True)).run(40)
    assert [rate for _, rate in talk.intervals("ATTITUDE")] == [50, 50, 40]
    assert len(talk.alerts) == 2  # ATTITUDE and RAW_IMU
    assert all("SCHED_LOOP_RATE" in text and "50 Hz wanted" in text for text in talk.alerts)
    assert talk.autopilot.rates["ATTITUDE"] == 40


def test_slow_loop_that_caps_is_good_enough():
    """Rover 4.6 at the default SCHED_LOOP_RATE of 50 Hz gives 40 Hz."""
    talk = Talk(Autopilot(loop_hz=50)).run(30)
    assert [rate for _, rate in talk.intervals("ATTITUDE")] == [50]
    assert talk.alerts == []


def test_hopeless_rate_backs_off_and_goes_on_warning():
    talk = Talk(Autopilot(loop_hz=20)).run(120)
    times = [t for t, _ in talk.intervals("ATTITUDE")]
    gaps = [round(b - a, 1) for a, b in pairwise(times)]
    assert gaps == [3.0, 6.0, 12.0, 24.0, 30.0, 30.0]
    assert any(text.startswith("ATTITUDE comes at 16.0 Hz") for text in talk.alerts)
    assert [rate for _, rate in talk.intervals("SYS_STATUS")] == [2]


def test_version_is_asked_for_until_it_comes_with_growing_pauses():
    talk = Talk(Autopilot(knows_version=False)).run(40)
    times = [round(t / S) for t, _ in talk.heard("COMMAND_LONG", 512)]
    assert times == [0, 2, 6, 14, 30]
    talk.autopilot.knows_version = True
    talk.run(100)
    assert len(talk.heard("COMMAND_LONG", 512)) == 6


def test_reboot_is_noticed_and_everything_is_asked_for_again():
    talk = Talk(Autopilot()).run(10)
    talk.autopilot.reboot(talk.t_ns)
    talk.run(10)
    assert [rate for _, rate in talk.intervals("ATTITUDE")] == [50, 50]
    assert 10 <= talk.intervals("ATTITUDE")[1][0] < 11
    assert len(talk.heard("COMMAND_LONG", 512)) == 2
    assert len(talk.alerts) == 1 and "rebooted" in talk.alerts[0]
    assert talk.codec.clock.offset_ns is not None
    assert abs(talk.codec.clock.offset_ns - 10 * S) <= 5 * MS


def test_the_filters_of_the_inertial_sensors_are_asked_for_once_and_again_after_a_reboot():
    """So that every log says how late its inertial samples are; an autopilot without them is left in peace."""
    talk = Talk(Autopilot()).run(10)
    names = [m.param_id for _, m in talk.heard("PARAM_REQUEST_READ")]
    assert sorted(names) == ["INS_ACCEL_FILTER", "INS_GYRO_FILTER"]
    talk.autopilot.reboot(talk.t_ns)
    talk.run(10)
    assert len(talk.heard("PARAM_REQUEST_READ")) == 4
    other = Autopilot()
    other.parameters.clear()
    talk = Talk(other).run(30)
    assert len(talk.heard("PARAM_REQUEST_READ")) == 8 and talk.heard("PARAM_REQUEST_READ")[-1][0] < 3 * S
    assert talk.alerts == []


def test_silence_stops_the_questions_and_its_end_begins_again():
    talk = Talk(Autopilot()).run(10)
    talk.autopilot.silent = True
    talk.run(20)
    asked = len(talk.heard("TIMESYNC")) + len(talk.heard("COMMAND_LONG"))
    talk.run(10)
    assert len(talk.heard("TIMESYNC")) + len(talk.heard("COMMAND_LONG")) == asked
    assert len(talk.heard("HEARTBEAT")) == 40
    talk.autopilot.silent = False
    talk.autopilot.rates.clear()
    talk.run(5)
    assert 40 <= talk.intervals("ATTITUDE")[-1][0] < 41
    assert len(talk.heard("COMMAND_LONG", 512)) == 2
    assert talk.codec.counters.received["ATTITUDE"] > 10 * 50 + 3 * 50


def signed_heartbeat(t_ns):
    mav = dialect.MAVLink(None, 1, 1)
    mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = bytes(range(32)), True, t_ns // 10_000
    return bytes(mav.heartbeat_encode(11, 3, 81, 0, 3).pack(mav))


def deaf_alerts(frames, *, answers):
    """What is said in 12 s of heartbeats; the questions' answers come unsigned, as all of a USB port's may."""
    codec, said = MavlinkCodec(), []
    session, sender = MavlinkSession(codec, {}), Sender()
    for k in range(120):
        t_ns, data = k * 100 * MS, b""
        if k % 10 == 0:
            data = frames(t_ns)
        out = session.step(codec.feed(data, t_ns), t_ns)
        for question in (read_one(frame) for frame in out if answers):
            if question.get_type() == "TIMESYNC":
                session.step(codec.feed(sender.timesync(t_ns + 1, question.ts1), t_ns), t_ns)
        said += [(t_ns / S, a.level, a.text) for a in session.take_alerts()]
    return said


def test_an_autopilot_that_signs_and_does_not_answer_is_named_within_seconds():
    said = deaf_alerts(signed_heartbeat, answers=False)
    assert [level for _, level, _ in said] == ["error"], "once in these seconds"
    assert said[0][0] < 3.0 and "signs" in said[0][2] and "mavlink.signing_key" in said[0][2]


def test_one_that_signs_and_answers_as_on_usb_is_no_trouble_and_neither_is_one_that_does_not_sign():
    assert deaf_alerts(signed_heartbeat, answers=True) == []
    assert deaf_alerts(lambda t_ns: Sender().heartbeat(11, 3, 81, 0, 3), answers=False) == []


def test_timesync_questions_are_answered():
    talk = Talk(Autopilot(), start_ns=100 * S).run(2)
    incoming = talk.codec.feed(talk.autopilot.sender.timesync(0, 4242), talk.t_ns)
    sent = [read_one(data) for data in talk.session.step(incoming, talk.t_ns)]
    assert [(m.tc1, m.ts1) for m in sent if m.get_type() == "TIMESYNC" and m.tc1] == [(talk.t_ns, 4242)]


def test_a_pause_of_the_caller_makes_no_burst():
    talk = Talk(Autopilot()).run(5)
    sent = talk.session.step([], talk.t_ns + 4 * S)
    assert [read_one(data).get_type() for data in sent].count("HEARTBEAT") == 1
    assert [read_one(data).get_type() for data in sent].count("TIMESYNC") == 1


def strangers_alerts(codec):
    """What is said while three autopilots are heard for a while."""
    session, said = MavlinkSession(codec, {}), []
    for k in range(5):
        for system in (3, 4, 5):
            session.step(codec.feed(Sender(system, 1).beat(), k * S), k * S)
            said += session.take_alerts()
    return said


def test_other_autopilots_are_told_once_each():
    said = strangers_alerts(MavlinkCodec())
    assert [a.level for a in said] == ["error", "error"]
    for alert, system in zip(said, (4, 5), strict=True):
        assert f"systems 3 and {system} are heard: this run keeps to 3" in alert.text
        assert "mavlink.autopilot_system_id" in alert.text
    said = strangers_alerts(MavlinkCodec(target_system=4))
    assert [a.level for a in said] == ["warning", "warning"]
    for alert, system in zip(said, (3, 5), strict=True):
        assert f"system {system} is heard, which is not ours (mavlink.autopilot_system_id = 4)" in alert.text
