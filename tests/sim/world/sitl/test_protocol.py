"""ArduPilot's JSON interface without sockets: the wire, the lockstep, and what the firmware is told of the boat.

`FACTS` of the interface as seen on the real firmware stand in the tests' names; the other side is `json_firmware`.
"""

import math
import socket
import struct
from dataclasses import replace
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.__main__ import main
from companion.boat.load_run import EXAMPLES
from companion.cli.simulator.firmware_options import ADDRESS
from companion.core.geometry.frames import R2
from companion.core.messages import UwbRanges
from companion.core.preflight.parameter_file import parse_parameters
from drivers.uwb import uwb_codec
from sim.world.environment import Weather
from sim.world.sitl.backend import LONGEST_FRAME_NS, SILENT_NS, JsonBackend, frame_ns
from sim.world.sitl.loopback import BEHIND_NS, JsonWires, Pace
from sim.world.sitl.physics import SitlPhysics
from sim.world.sitl.protocol import PORT, NotServos, PhysicsState, decode, encode
from sim.world.world import STEP_NS, Afloat, WorldSetup
from tests.sim.world.sitl.json_firmware import parse
from tests.support.drive_fixture import setup
from tests.support.vessel_fixtures import boat

MS = 1_000_000
S = 1000 * MS
SITE = setup().pilot.site
START = (8.0, 9.0, 0.4)
finite = st.floats(-1e6, 1e6)
vectors = st.tuples(finite, finite, finite)
states = st.builds(
    PhysicsState,
    timestamp_s=st.floats(0, 1e6),
    gyro_rad_s=vectors,
    accel_m_s2=vectors,
    position_m=vectors,
    velocity_m_s=vectors,
    attitude_rad=vectors,
    voltage_v=st.floats(0, 60),
    current_a=st.floats(0, 200),
)
AT_REST = PhysicsState(1.0, (0.0,) * 3, (0.0, 0.0, -9.8), (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, 15.6, 1.5)


def packet(count=0, rate=200, pulses=(1500,) * 4, outputs=16):
    magic = {16: 18458, 32: 29569}[outputs]
    return struct.pack(f"<HHI{outputs}H", magic, rate, count, *pulses, *[0] * (outputs - len(pulses)))


# --- the wire ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("outputs", [16, 32])
@given(rate=st.integers(0, 65535), count=st.integers(0, 2**32 - 1), data=st.data())
def test_little_endian_magic_18458_has_16_pulses_and_29569_has_32(outputs, rate, count, data):
    pulses = data.draw(st.lists(st.integers(0, 65535), min_size=outputs, max_size=outputs))
    told = decode(packet(count, rate, pulses, outputs))
    assert (told.frame_rate_hz, told.frame_count, told.pulses_us) == (rate, count, tuple(pulses))


@given(st.binary(max_size=100))
def test_anything_else_is_refused(data):
    magics = (struct.pack("<H", 18458), struct.pack("<H", 29569))
    if data[:2] in magics and len(data) in (40, 72):
        return
    with pytest.raises(NotServos, match=r"bytes|magic"):
        decode(data)


@pytest.mark.parametrize(
    "data", [packet()[:-1], packet() + b"\0", packet(outputs=32)[:40], struct.pack(">HHI16H", 18458, *[0] * 18)]
)
def test_a_packet_cut_short_too_long_or_big_endian_is_refused(data):
    with pytest.raises(NotServos):
        decode(data)


@given(states)
def test_a_state_is_a_line_between_line_feeds_and_the_firmware_finds_every_number_in_it(state):
    data = encode(state)
    assert data[:2] == b"\n{" and data[-2:] == b"}\n" and data.count(b"\n") == 2
    assert parse(data.decode("ascii")) == {
        "timestamp": state.timestamp_s,
        "gyro": list(state.gyro_rad_s),
        "accel_body": list(state.accel_m_s2),
        "position": list(state.position_m),
        "attitude": list(state.attitude_rad),
        "velocity": list(state.velocity_m_s),
        "voltage": state.voltage_v,
        "current": state.current_a,
    }


@given(states)
def test_no_space_after_a_colon_or_the_firmware_cannot_read_it(state):
    text = encode(state).decode("ascii")
    assert ": " not in text
    assert parse(text.replace(":", ": ")) is None


def test_a_state_that_is_not_finite_never_leaves():
    with pytest.raises(ValueError, match="JSON"):
        encode(replace(AT_REST, voltage_v=math.nan))


def test_the_firmware_sends_to_port_9002_and_ten_more_for_each_instance(capsys):
    assert f"127.0.0.1:{PORT}" == ADDRESS == "127.0.0.1:9002" and JsonWires().bind == ("127.0.0.1", 9002)


@pytest.mark.parametrize("name", ["gate", "scaled", "omni", "unsafe_plain"])
def test_the_parameter_files_put_the_thrusters_on_outputs_1_to_4(name):
    """In the vessel file's order: channels 9-12, motors 1-4; so pulses 1-4 of a packet drive thrusters 1-4."""
    told = parse_parameters((EXAMPLES / "ardupilot" / f"{name}.param").read_text(), name=name)
    first = {"gate": 94, "scaled": 148, "omni": 33, "unsafe_plain": 59}[name]
    assert [told[f"SERVO{n}_FUNCTION"] for n in range(1, 5)] == [first, first + 1, first + 2, first + 3]


# --- the lockstep --------------------------------------------------------------------------------------


class Clockwork:
    """A world that counts."""

    def __init__(self):
        self.t_ns, self.steps, self.restarts, self.pulses = 0, [], 0, ()

    def advance(self, outputs_us, frame_ns):
        self.t_ns += frame_ns
        self.steps.append(frame_ns)
        self.pulses = outputs_us
        return replace(AT_REST, timestamp_s=self.t_ns * 1e-9), b"uwb"

    def restart(self):
        self.t_ns = 0
        self.restarts += 1


class Line:
    """A backend with a firmware's packets, 5 ms apart."""

    def __init__(self):
        self.world, self.now_ns = Clockwork(), 7 * S
        self.backend = JsonBackend(self.world)

    def send(self, count, *, sender="a", after_ns=5 * MS, **told):
        self.now_ns += after_ns
        return self.backend.receive(packet(count, **told), sender, self.now_ns)

    def time_of(self, answer):
        return parse(answer.data.decode("ascii"))["timestamp"]


@pytest.fixture
def line():
    return Line()


def test_a_state_leaves_only_as_the_answer_to_a_servo_packet(line):
    for _ in range(100):
        line.now_ns += S
        line.backend.watch(line.now_ns)
    assert line.world.steps == []
    answer = line.send(0)
    assert line.world.steps == [5 * MS] and answer.stepped and answer.uwb == b"uwb"


def test_the_pulses_of_the_packet_drive_the_step(line):
    line.send(0, pulses=(1600, 1400, 0, 1500))
    assert line.world.pulses[:4] == (1600, 1400, 0, 1500)


def test_after_a_second_of_silence_the_same_frame_count_comes_again_and_gets_the_same_answer(line):
    first = line.send(0)
    again = [line.send(0, after_ns=S) for _ in range(3)]
    assert {a.data for a in again} == {first.data} and not any(a.stepped or a.uwb for a in again)
    assert len(line.world.steps) == 1 and line.backend.counters.repeated == 3
    assert line.time_of(line.send(1)) == pytest.approx(0.01)


def test_repeats_that_had_queued_up_get_one_answer_between_them(line):
    """This program was stopped for a minute: the firmware must not find sixty answers, and lag by sixty frames."""
    answers = [line.send(0, after_ns=0) for _ in range(61)]
    assert answers[0].stepped and answers[1:] == [None] * 60
    assert line.send(0, after_ns=S).data == answers[0].data, "lost after all: it asks once more"
    assert [line.send(0, after_ns=0) for _ in range(3)] == [None] * 3


def test_a_lower_frame_count_is_a_firmware_started_again_and_resets_the_world(line):
    for count in range(50):
        line.send(count)
    line.backend.take_news()
    assert line.time_of(line.send(0)) == pytest.approx(0.005)
    assert line.world.restarts == line.backend.counters.restarts == 1
    assert line.backend.take_news() == ["firmware started again (frame 0 after 49): the boat is back at its start"]


def test_frames_that_were_missed_are_counted_and_told(line):
    line.send(0)
    assert line.time_of(line.send(4)) == pytest.approx(0.01), "one step, for the firmware's clock goes by our time"
    assert line.backend.counters.missed == 3
    assert "frames missed: 3 (now 4), 3 in all" in line.backend.take_news()


def test_a_simulator_started_again_takes_any_frame_count_and_its_time_begins_anew(line):
    """The firmware sees the timestamp go back and goes on: `test_ardupilot_json_process`."""
    assert line.time_of(line.send(123_456)) == pytest.approx(0.005)
    assert line.backend.counters.missed == line.world.restarts == 0


@pytest.mark.parametrize(("rate", "ms"), [(1200, 1 / 1.2), (400, 2.5), (200, 5), (50, 20), (20, 50), (10, 50), (0, 50)])
def test_the_frame_rate_asks_for_the_step_which_stays_below_a_tenth_of_a_second(line, rate, ms):
    line.send(0, rate=200)
    line.send(1, rate=rate)
    assert line.world.steps[1] == pytest.approx(ms * MS, abs=1)


@given(st.integers(0, 65535))
def test_a_step_is_never_longer_than_asked_for_nor_none_at_all(rate):
    assert 0 < frame_ns(rate) <= LONGEST_FRAME_NS < 0.1 * S
    assert frame_ns(rate) * rate <= S


def test_a_firmware_that_goes_silent_is_told_once_and_so_is_its_return(line):
    line.send(0)
    line.backend.take_news()
    for _ in range(10):
        line.now_ns += S
        line.backend.watch(line.now_ns)
    assert line.backend.take_news() == ["firmware silent for 2 s, the world waits for it"]
    assert line.time_of(line.send(1)) == pytest.approx(0.01)
    assert line.backend.take_news() == ["firmware back after 10.0 s"]
    line.backend.watch(line.now_ns)
    assert line.backend.take_news() == []


@pytest.mark.parametrize(("gap_ms", "pace"), [(10, "0.50"), (5, None), (1, "5.00")])
def test_it_is_told_once_that_simulated_time_is_not_real_time(line, gap_ms, pace):
    for count in range(20_000 // gap_ms):
        line.send(count, after_ns=gap_ms * MS)
        line.backend.watch(line.now_ns)
    told = [text for text in line.backend.take_news() if "real time" in text]
    assert len(told) == (pace is not None) and all(f"runs at {pace} of real time; " in text for text in told)
    for count in range(20_000 // gap_ms, 20_000 // gap_ms + 3000):
        line.send(count)
        line.backend.watch(line.now_ns)
    back = [text for text in line.backend.take_news() if "real time" in text]
    assert back == (["simulated time runs at 1.00 of real time"] if pace else [])


def test_a_firmware_that_waits_and_asks_again_is_not_silent(line):
    """It asks again after a second; losing that too would be bad luck."""
    line.send(0)
    line.backend.take_news()
    for _ in range(5):
        line.send(0, after_ns=1_100 * MS)
        line.backend.watch(line.now_ns + 1_000 * MS)
    assert not any("silent" in text for text in line.backend.take_news())


def test_a_second_firmware_does_not_displace_a_live_one(line):
    for count in range(100):
        assert line.send(count, after_ns=S).stepped
        assert line.send(0, sender="b", after_ns=500 * MS) is None
    assert line.backend.counters.strangers == 100 and line.world.restarts == 0
    assert sum("b waits" in text for text in line.backend.take_news()) == 1
    assert line.send(0, sender="b", after_ns=SILENT_NS).stepped and line.world.restarts == 1


def test_garbage_is_counted_told_once_and_harmless(line):
    line.send(0)
    assert all(line.backend.receive(b"hello", "c", line.now_ns) is None for _ in range(9))
    assert line.backend.counters.garbage == 9
    assert sum("ignored what c sent: 5 bytes" in text for text in line.backend.take_news()) == 1
    assert line.send(1).stepped


@settings(max_examples=60)
@given(st.lists(st.tuples(st.sampled_from(["next", "again", "jump", "restart", "garbage", "other"]), st.integers(0, 2)),
                max_size=60))  # fmt: skip
def test_whatever_comes_each_frame_is_one_step_and_time_goes_on(doings):
    """Steps = packets of ours that were new; between restarts the timestamps rise by exactly the steps."""
    line, count, new, told = Line(), 0, 1, []
    told.append(line.time_of(line.send(0)))
    for doing, seconds in doings:
        if doing == "garbage":
            line.backend.receive(b"\0" * 40, "a", line.now_ns)
            continue
        if doing == "other":
            line.send(0, sender="b", after_ns=0)
            continue
        before, count = count, {"next": count + 1, "again": count, "jump": count + 5, "restart": 0}[doing]
        fresh = doing in ("next", "jump") or (doing == "restart" and before != 0)
        answer = line.send(count, after_ns=seconds * S + MS)
        if not fresh and not seconds:
            assert answer is None
            continue
        assert answer.stepped == fresh
        new += fresh
        if doing == "restart" and fresh:
            told = []
        if fresh:
            told.append(line.time_of(answer))
        else:
            assert line.time_of(answer) == told[-1]
    assert len(line.world.steps) == line.backend.counters.steps == new
    assert all(b - a == pytest.approx(0.005) for a, b in pairwise(told))


# --- what the firmware is told ---------------------------------------------------------------------------


def physics(seed=1, name="aritra", site=SITE, imu=None, **changes):
    vessel = boat(name)
    if imu:
        sensors = msgspec.structs.replace(vessel.sensors, imu=msgspec.structs.replace(vessel.sensors.imu, **imu))
        vessel = msgspec.structs.replace(vessel, sensors=sensors)
    return SitlPhysics(WorldSetup(vessel, site, **{"start": START, **changes}), seed)


def drive(made, seconds, pulses=(1500,) * 4, rate=200):
    return [made.advance(pulses, frame_ns(rate))[0] for _ in range(round(seconds * rate))]


TURN = (1650, 1500, 1600, 1500)


def test_at_rest_the_accelerometer_says_minus_9_80665_down_and_nothing_else():
    state = drive(physics(), 1.0)[-1]
    assert state.accel_m_s2 == pytest.approx((0, 0, -9.80665), abs=1e-9) and state.gyro_rad_s == (0, 0, 0)
    assert state.position_m == pytest.approx((START[0], START[1], 0)) and state.velocity_m_s == (0, 0, 0)
    assert state.attitude_rad == pytest.approx((0, 0, START[2]))


def test_it_is_the_plant_of_the_loopback_and_no_other():
    """Frames of 10 ms are the loopback's own steps: the same motion to the last bit."""
    setup_ = WorldSetup(boat("aritra"), SITE, start=START, weather=Weather(0.1, 70.0, 0.0, 4.0, 200.0, 0.3, 0.1))
    made, plain = SitlPhysics(setup_, 3), Afloat(setup_, 3)
    for _ in range(500):
        state, uwb = made.advance(TURN, STEP_NS)
        plain.advance(TURN)
        assert uwb == plain.tag_bytes()
    assert np.array_equal(made.world.plant.motion.x, plain.plant.motion.x) and abs(made.world.plant.motion.x[5]) > 0.1
    assert state.position_m[:2] == tuple(plain.plant.motion.x[:2])


def test_states_hold_together_as_a_strapdown_computer_would_put_them():
    """Specific force, turned to NED, gravity added, integrated: velocity; that integrated: position; gyro: yaw."""
    told = drive(physics(imu={"x_m": 0.0, "y_m": 0.0}), 8.0, TURN)
    velocity, position, yaw = np.zeros(2), np.array(START[:2]), START[2]
    for a, b in pairwise(told):
        dt = b.timestamp_s - a.timestamp_s
        middle = yaw + dt * (a.gyro_rad_s[2] + b.gyro_rad_s[2]) / 4
        yaw += dt * (a.gyro_rad_s[2] + b.gyro_rad_s[2]) / 2
        before = velocity
        velocity = velocity + dt * R2(middle) @ (np.array(a.accel_m_s2[:2]) + b.accel_m_s2[:2]) / 2
        position = position + dt * (before + velocity) / 2
    last = told[-1]
    assert np.hypot(*last.velocity_m_s[:2]) > 0.2 and abs(yaw - START[2]) > 0.5
    assert velocity == pytest.approx(last.velocity_m_s[:2], abs=2e-3)
    assert position == pytest.approx(last.position_m[:2], abs=5e-3)
    assert math.remainder(yaw - last.attitude_rad[2], math.tau) == pytest.approx(0, abs=1e-4)


def test_in_waves_the_gyro_integrates_to_the_attitude():
    """Turning in a seaway: dR/dt = R S(omega), and Z-Y-X angles of R are those told."""
    told = drive(physics(weather=Weather(H_s_m=0.3)), 6.0, TURN)
    rolls = [s.attitude_rad[0] for s in told]
    assert max(rolls) - min(rolls) > 0.05
    phi, theta, psi = told[0].attitude_rad
    c, s = np.cos, np.sin
    R = (
        np.array([[c(psi), -s(psi), 0], [s(psi), c(psi), 0], [0, 0, 1]])
        @ np.array([[c(theta), 0, s(theta)], [0, 1, 0], [-s(theta), 0, c(theta)]])
        @ np.array([[1, 0, 0], [0, c(phi), -s(phi)], [0, s(phi), c(phi)]])
    )
    for a, b in pairwise(told):
        p, q, r = np.array(b.gyro_rad_s) * (b.timestamp_s - a.timestamp_s)
        angle = math.sqrt(p * p + q * q + r * r)
        K = np.array([[0, -r, q], [r, 0, -p], [-q, p, 0]]) / (angle or 1.0)
        R = R @ (np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K)
    last = told[-1].attitude_rad
    assert math.atan2(R[2, 1], R[2, 2]) == pytest.approx(last[0], abs=0.01)
    assert -math.asin(R[2, 0]) == pytest.approx(last[1], abs=0.01)
    assert math.remainder(math.atan2(R[1, 0], R[0, 0]) - last[2], math.tau) == pytest.approx(0, abs=0.01)
    assert np.linalg.norm(told[-1].accel_m_s2) == pytest.approx(9.8, abs=1.0)


@pytest.mark.parametrize("rate", [1200, 400, 100, 50, 10])
def test_the_length_of_a_frame_changes_the_motion_by_less_than_a_millimetre(rate):
    """Slower frames are steps of 10 ms inside; pulses act from the frame's beginning, as at 200 Hz."""
    fast, other = physics(), physics()
    drive(fast, 3.0, TURN)
    while other.world.t_ns < 3 * S - MS:
        other.advance(TURN, frame_ns(rate))
    a, b = fast.world.plant.motion, other.world.plant.motion
    assert b.t_ns == pytest.approx(a.t_ns, abs=10 * MS)
    assert b.x[:2] + (a.t_ns - b.t_ns) * 1e-9 * R2(b.x[2]) @ b.x[3:5] == pytest.approx(a.x[:2], abs=1e-3)


def test_in_a_basin_that_is_turned_the_firmware_is_told_true_north():
    turned = msgspec.structs.replace(SITE, rotation_deg=30.0)
    straight, told = drive(physics(), 4.0, TURN)[-1], drive(physics(site=turned), 4.0, TURN)[-1]
    R = R2(math.radians(30.0))
    assert told.position_m[:2] == pytest.approx(R @ straight.position_m[:2])
    assert told.velocity_m_s[:2] == pytest.approx(R @ straight.velocity_m_s[:2])
    assert told.attitude_rad[2] == pytest.approx(straight.attitude_rad[2] + math.radians(30.0))
    assert told.accel_m_s2 == pytest.approx(straight.accel_m_s2)


def test_errors_that_the_vessel_file_knows_of_are_in_and_noise_is_not():
    """The companion takes the former out; the firmware adds the latter."""
    wrong = {"heading_offset_rad": 0.1, "accel_bias_x_m_s2": 0.2, "gyro_bias_rad_s": 0.03}
    clean, told = drive(physics(), 0.1)[-1], drive(physics(imu=wrong), 0.1)[-1]
    assert told.attitude_rad[2] - clean.attitude_rad[2] == pytest.approx(0.1)
    assert told.accel_m_s2[0] - clean.accel_m_s2[0] == pytest.approx(0.2)
    assert told.gyro_rad_s[2] == pytest.approx(0.03)
    assert drive(physics(seed=1), 0.1) == drive(physics(seed=2), 0.1)


def test_the_battery_sags_under_load():
    made = physics()
    rest, loaded = drive(made, 0.5)[-1], drive(made, 2.0, (1800,) * 4)[-1]
    assert rest.voltage_v > loaded.voltage_v > 10 and loaded.current_a > rest.current_a + 5


def test_a_restart_puts_the_boat_back_and_leaves_the_tag_on():
    made = physics()
    uwb = made.world.vessel.sensors.uwb
    codec = uwb_codec(uwb.wire_format, "tag", uwb.rate_Hz)
    for data in codec.start_bytes():
        codec.feed(made.world.uwb(data), made.world.t_ns)

    def ranges(seconds):
        heard = []
        for k in range(round(seconds * 200)):
            if k % 20 == 0:
                for data in codec.step(made.world.t_ns):
                    heard += codec.feed(made.world.uwb(data), made.world.t_ns)
            heard += codec.feed(made.advance(TURN, frame_ns(200))[1], made.world.t_ns)
        return [m for m in heard if isinstance(m, UwbRanges)]

    assert len(ranges(8.0)) >= 3
    first, before_ns = physics().advance(TURN, frame_ns(200))[0], made.world.t_ns
    made.restart()
    assert made.world.t_ns == before_ns, "the tag's time goes on"
    assert made.advance(TURN, frame_ns(200))[0] == first
    assert len(ranges(4.0)) >= 3, "without being spoken to again"


# --- pace and command line -------------------------------------------------------------------------------


@given(st.floats(0.1, 10), st.lists(st.tuples(st.integers(1, 50 * MS), st.integers(0, 300 * MS)), max_size=100))
def test_the_pace_holds_back_and_never_makes_up(speed, frames):
    """Over any stretch simulated time gains at most the stall's allowance on `speed` times real time."""
    pace, world_ns, now_ns, start = Pace(speed), 0, 0, None
    for step_ns, busy_ns in frames:
        world_ns, now_ns = world_ns + step_ns, now_ns + busy_ns
        wait_ns = pace.wait_ns(world_ns, now_ns)
        assert wait_ns >= 0
        now_ns += wait_ns
        start = start or (world_ns, now_ns)
        assert (world_ns - start[0]) / speed <= now_ns - start[1] + BEHIND_NS + 1000


def test_without_a_speed_nothing_is_held_back():
    assert Pace(None).wait_ns(10 * S, 0) == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--ardupilot-json", "--wiring", "gate"], "--wiring: is for the simulated autopilot"),
        (["--ardupilot-json", "--udp-to", "1.2.3.4:5"], "--udp-to: is for"),
        (["--ardupilot-json", "--param", "SYSID_MYGCS=2"], "--param: is for"),
        (["--speed", "2"], "--speed: goes with --ardupilot-json"),
        (["--ardupilot-json", "nowhere"], "'nowhere': expected HOST:PORT"),
    ],
)
def test_options_that_do_not_go_together_are_refused(words, told, capsys):
    assert main(["sim", *words]) == 2
    assert told in capsys.readouterr().err


def test_a_taken_port_is_named_with_what_to_do(tmp_path, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        taken = f"127.0.0.1:{other.getsockname()[1]}"
        assert main(["sim", "--ardupilot-json", taken, "--uwb", str(tmp_path / "tag")]) == 1
    told = capsys.readouterr().err
    assert f"udp {taken}: Address already in use" in told and "-I1" in told
    assert not (tmp_path / "tag").exists()
