"""A ground station beside the companion: what it sees, what it may say, and that it can hold nothing up."""

import asyncio
import contextlib
import socket

import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.boat.clock import BoatClock
from companion.boat.gcs_forward import GcsForward
from companion.core.messages import Alert, OverrideLease
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.framing import Framer
from drivers.mavlink.gcs_firewall import GcsFirewall
from drivers.mavlink.statustext import ChunkJoiner
from drivers.ports.udp import UdpClientPort
from tests.companion.boat.app_fixture import Bench, neutral
from tests.support.stand_ins.memory_port import memory_pair
from tests.support.stand_ins.sim_clock import SimClock

S = 1_000_000_000
ENCODER = MavlinkCodec(1, 191, 1).encoder


class Station:
    """Test's ground station, plain pymavlink, at the far end of a cable."""

    def __init__(self, writable):
        self.near, self.far = memory_pair("station")
        self.mav = wire.MAVLink(None, 255, 190)
        self.got, self.gate = [], GcsFirewall(1) if writable else None
        self.forward = None

    def __call__(self, clock):
        self.forward = GcsForward(self.near, self.gate, clock, ENCODER.statustext)
        return self.forward

    async def listen(self):
        parser = wire.MAVLink(None)
        parser.robust_parsing = True
        await self.far.open()
        while data := await self.far.receive():
            self.got += parser.parse_buffer(data) or []

    def say(self, kind, *fields):
        self.far.send(kind(*fields).pack(self.mav))

    def command(self, number, *params):
        self.say(wire.MAVLink_command_long_message, 1, 1, number, 0, *params, *[0.0] * (7 - len(params)))

    def texts(self):
        """Texts of the companion that the station shows, joined."""
        joiner, found = ChunkJoiner(), []
        for m in self.got:
            if m.get_type() == "STATUSTEXT" and m.get_srcComponent() == 191:
                found += joiner.add(m.severity, m.text.encode(), m.id, m.chunk_seq, 0)
        return [text.text for text in found]

    def types(self, system=None, component=None):
        return {
            m.get_type() for m in self.got
            if system is None or (m.get_srcSystem(), m.get_srcComponent()) == (system, component)
        }  # fmt: skip


def play(path, writable, tale):
    """`tale(bench, station)` in a run under way."""
    station = Station(writable)
    bench = Bench(path / "run.mcap", station=station)

    async def story(bench):
        ear = asyncio.create_task(station.listen())
        try:
            await bench.drive()
            await tale(bench, station)
        finally:
            ear.cancel()

    assert bench.scene(story) is None
    return bench, station


def override(station, pwm_us):
    station.say(wire.MAVLink_rc_channels_override_message, 1, 1, *[pwm_us] * 18)


def test_the_station_sees_autopilot_and_companion_and_cannot_touch(tmp_path):
    async def tale(bench, station):
        for _ in range(20):
            override(station, 1900)
            station.command(400, 0)
            await bench.run(0.05)

    bench, station = play(tmp_path, False, tale)
    assert {"HEARTBEAT", "ATTITUDE", "RAW_IMU", "SERVO_OUTPUT_RAW", "SYS_STATUS"} <= station.types(1, 1)
    assert {"HEARTBEAT", "RC_CHANNELS_OVERRIDE", "COMMAND_LONG"} <= station.types(1, 191)
    assert "BAD_DATA" not in station.types()
    own = [m for m in station.got if m.get_srcComponent() == 191]
    assert not [m for m in own if m.get_type() == "TIMESYNC"]
    assert len([m for m in own if m.get_type() == "RC_CHANNELS_OVERRIDE"]) > len(bench.of(OverrideLease)) // 2
    assert station.forward.read_only_bytes > 20 * 40
    assert {m.get_srcSystem() for _, m in bench.sent} == {1}, "nothing of it reached the autopilot"
    (alert,) = [a for a in bench.of(Alert) if "ground station" in a.text]
    assert "forward.writable is false" in alert.text and alert.level == "info"


def test_a_writable_station_can_take_the_boat_away_but_not_drive_it(tmp_path):
    async def tale(bench, station):
        for _ in range(10):
            override(station, 1900)
            station.command(183, 1, 1900)
            station.say(wire.MAVLink_param_set_message, 1, 1, b"SERVO1_TRIM", 1900.0, 9)
            await bench.run(0.05)
        assert bench.mode == "auto"
        station.command(400, 0)
        await bench.run(1.5)
        assert bench.mode == "safe" and neutral(bench.overrides[-1][1])
        assert not bench.world.rover.vehicle.modes.armed
        station.say(wire.MAVLink_param_request_read_message, 1, 1, b"RC_OVERRIDE_TIME", -1)
        await bench.run(0.3)

    bench, station = play(tmp_path, True, tale)
    passed = [m.get_type() for _, m in bench.sent if m.get_srcSystem() == 255]
    assert passed == ["COMMAND_LONG", "PARAM_REQUEST_READ"]
    assert "PARAM_VALUE" in station.types(1, 1), "and its answer comes back"
    texts = [a.text for a in bench.of(Alert) if "ground station" in a.text]
    words = station.texts()
    for what in ("RC_CHANNELS_OVERRIDE", "DO_SET_SERVO", "PARAM_SET"):
        assert len([t for t in texts if f"ground station's {what} not passed on" in t]) == 1
        assert len([t for t in words if t.startswith(f"Aritra: {what} refused: ")]) == 1


@pytest.mark.long
def test_the_station_hears_of_a_refusal_again_when_it_tries_a_minute_later(tmp_path):
    async def tale(bench, station):
        for _ in range(2):
            for _ in range(20):
                override(station, 1900)
                await bench.run(0.1)
            station.say(wire.MAVLink_radio_status_message, 200, 200, 100, 0, 0, 0, 0)
            await bench.run(60.0)

    bench, station = play(tmp_path, True, tale)
    text = "Aritra: RC_CHANNELS_OVERRIDE refused: takes the thrusters' channels from us"
    assert [t for t in station.texts() if t.startswith("Aritra")] == [text, text], (
        "and not of what a radio says by itself"
    )
    assert len([a for a in bench.of(Alert) if "ground station" in a.text]) == 1


def test_settings_pass_once_disarmed(tmp_path):
    async def tale(bench, station):
        station.command(400, 0)
        await bench.run(2.5)
        station.say(wire.MAVLink_param_set_message, 1, 1, b"RC_OVERRIDE_TIME", 1.5, 9)
        await bench.run(0.3)
        assert bench.world.rover.vehicle.parameters["RC_OVERRIDE_TIME"] == 1.5

    play(tmp_path, True, tale)


@pytest.mark.long
def test_a_station_that_goes_and_comes_back_changes_nothing_for_the_boat(tmp_path):
    async def tale(bench, station):
        await station.far.close()
        await bench.run(3.0)
        before = len(station.got)
        again = asyncio.create_task(station.listen())
        await bench.run(3.0)
        again.cancel()
        assert len(station.got) > before + 100
        assert bench.mode == "auto"

    bench, _ = play(tmp_path, False, tale)
    assert set(bench.leases_per_tick()[:-12]) == {1}
    assert len([a for a in bench.of(Alert) if a.text.startswith("forward: ")]) == 1


def test_what_a_full_port_does_not_take_is_dropped_and_counted():
    """Nobody reads at the far end: memory stays bounded, `show` returns at once, the count says what was lost."""
    near, far = memory_pair("slow", limit_bytes=2000)
    forward = GcsForward(near, None, SimClock(), ENCODER.statustext)
    frame = MavlinkCodec(1, 191, 1).encoder.heartbeat()

    async def story():
        await far.open()
        task = asyncio.create_task(forward.run(print, print, lambda: False))
        await asyncio.sleep(0)
        for _ in range(1000):
            forward.show(frame)
        assert near.counters.dropped_bytes >= 1000 * len(frame) - 2000 - len(frame)
        assert far.waiting_bytes <= 2000
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task

    asyncio.run(story())


def test_before_its_port_is_open_frames_are_dropped():
    near, far = memory_pair("shut")
    forward = GcsForward(near, None, SimClock(), ENCODER.statustext)
    forward.show(b"\xfd" * 20)
    assert forward.shown == 0 and not far.waiting_bytes


@pytest.mark.parametrize("cut", [1, 7, 40, 500])
def test_frames_reach_the_station_whole_however_the_wire_cuts_them(cut):
    """Each send is one whole frame; noise between frames is not shown; frames of unknown types are."""
    mav = wire.MAVLink(None, 1, 1)
    beat = bytes(wire.MAVLink_heartbeat_message(11, 3, 65, 0, 4, 3).pack(mav))
    strange = bytes([0xFD, 4, 0, 0, 9, 1, 1, 0xFE, 0xFF, 0xEE, 1, 2, 3, 4, 0, 0])
    shown, framer = [], Framer()
    framer.on_frame = shown.append
    stream = beat + strange + beat + b"noise" + beat
    for at in range(0, len(stream), cut):
        framer.feed(stream[at : at + cut], S)
    assert shown == [beat, strange, beat, beat]


def test_over_udp_to_a_station_that_comes_late():
    """Real sockets: nobody there at first (the kernel says refused), then a station that hears whole datagrams."""
    beat = MavlinkCodec(1, 191, 1).encoder.heartbeat()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:
        late.bind(("127.0.0.1", 0))
        port = late.getsockname()[1]
        late.close()

        async def story():
            client = UdpClientPort("127.0.0.1", port)
            forward, told = GcsForward(client, GcsFirewall(1), BoatClock(), ENCODER.statustext), []
            passed = []
            task = asyncio.create_task(forward.run(passed.append, told.append, lambda: True))
            await asyncio.sleep(0.05)
            for _ in range(20):
                forward.show(beat)
                await asyncio.sleep(0.002)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
                station.bind(("127.0.0.1", port))
                station.setblocking(False)
                for _ in range(20):
                    forward.show(beat)
                    await asyncio.sleep(0.002)
                data, address = station.recvfrom(2048)
                assert data == beat
                hello = bytes(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(wire.MAVLink(None, 255, 190)))
                station.sendto(hello, address)
                for _ in range(200):
                    await asyncio.sleep(0.005)
                    if passed:
                        break
                assert passed == [hello]
            assert client.counters.refused_datagrams > 0 and not told
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

        asyncio.run(story())


def test_a_url_that_is_none_is_named_by_its_key(tmp_path, capsys):
    from companion.__main__ import main
    from companion.boat.load_run import EXAMPLES

    text = (EXAMPLES / "aritra.toml").read_text() + '\n[forward]\nurl = "14550"\n'
    for name in ("boats", "sites", "missions"):
        text = text.replace(f'"{name}/', f'"{EXAMPLES}/{name}/')
    (tmp_path / "run.toml").write_text(text)
    assert main(["run", "--config", str(tmp_path / "run.toml"), "--log", str(tmp_path / "x.mcap")]) == 2
    assert f"{tmp_path / 'run.toml'}: forward.url: port '14550': expected one of" in capsys.readouterr().err
