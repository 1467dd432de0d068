"""The world as bytes: repeatable from its seed, with the tag's latency, with other boats, and quick."""

import hashlib
import time
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from companion.core.messages import Heartbeat, ImuSample, OverrideLease, UwbRanges
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.encode import MavlinkEncoder
from drivers.uwb import uwb_codec
from sim.world.environment import Moment, Weather
from sim.world.sensors import UwbFaults
from sim.world.world import STEP_NS, Afloat, World, WorldSetup
from tests.support.drive_fixture import START, setup
from tests.support.vessel_fixtures import boat

SITE = setup().pilot.site
ROUGH = {"weather": Weather(0.1, 70.0, 0.0, 4.0, 200.0, 0.3, 0.1), "mismatch": 0.1, "faults": UwbFaults(0.1, 0.1)}
PEER = "boat"
FLAT = Moment(0.0, 0.0, 0.0, 0.0, np.zeros(3), 0.0, 0.0)


def world(seed=1, name="aritra", **changes):
    made = World(WorldSetup(boat(name), SITE, **{"start": START, **changes}), seed)
    made.rover.add_link(PEER)
    start_tag(made)
    return made


def start_tag(made):
    """Speak to the tag until its stream runs."""
    uwb = made.vessel.sensors.uwb
    codec = uwb_codec(uwb.wire_format, "tag", uwb.rate_Hz)
    made.tag_codec = codec
    for data in codec.start_bytes():
        codec.feed(made.uwb(data), made.t_ns)


def talk(made):
    """What the codec wants to say to the tag by now."""
    for data in made.tag_codec.step(made.t_ns):
        made.tag_codec.feed(made.uwb(data), made.t_ns)


def lease(pwm_us):
    n = len(pwm_us)
    return OverrideLease(
        t_ns=0, index=0, channels=(*range(9, 9 + n), 1, 2, 3, 4), pwm_us=pwm_us + (1500,) * 4, valid_for_s=0.3,
        source="plan", reason="", f_command_n=(0.0,) * n,
    )  # fmt: skip


def digest(made, seconds):
    """SHA-256 of all bytes, with overrides going in all the while."""
    sum_, encoder = hashlib.sha256(), MavlinkEncoder(1, 191, 1, 1)
    for k in range(round(seconds * 1e9 / STEP_NS)):
        if k % 10 == 0:
            talk(made)
            sum_.update(made.mavlink(encoder.neutral((9, 10, 11, 12, 1, 2, 3, 4)), PEER))
        out = made.step()
        for _, data in out.mavlink:
            sum_.update(data)
        sum_.update(out.uwb)
    return sum_.hexdigest(), made.truth()


def test_the_same_seed_gives_the_same_bytes_and_another_one_others():
    one, two, other = (digest(world(seed, **ROUGH), 30) for seed in (1, 1, 2))
    assert one == two
    assert one[0] != other[0] and one[1] != other[1]


@pytest.mark.parametrize("change", [{"mismatch": 0.0}, {"faults": UwbFaults()}, {"weather": Weather()}])
def test_sources_of_chance_are_apart(change):
    """Without wind the ranges' noise is still the same: each thing draws from its own generator."""
    full, less = world(3, **ROUGH), world(3, **{**ROUGH, **change})
    a, b = full.imu.measure(full.plant.motion, FLAT), less.imu.measure(less.plant.motion, FLAT)
    assert a == b


@pytest.mark.parametrize("latency_s", [0.08, 0.0, 0.35])
def test_uwb_bytes_come_the_tags_latency_after_the_measurement(latency_s):
    vessel = boat("aritra")
    uwb = msgspec.structs.replace(vessel.sensors.uwb, latency_s=latency_s, range_sigma_m=1e-6, range_bias_sigma_m=0.0)
    vessel = msgspec.structs.replace(vessel, sensors=msgspec.structs.replace(vessel.sensors, uwb=uwb))
    made = World(WorldSetup(vessel, SITE, start=START, weather=Weather(V_c_m_s=0.3)), 1)
    start_tag(made)
    made.plant.motion.x[3] = 1.0
    places, heard = [], []
    for k in range(800):
        if k % 10 == 0:
            talk(made)
        data = made.step().uwb
        places.append((made.t_ns, made.uwb_sensor.tag_position(made.plant.motion.x)))
        heard += [m for m in made.tag_codec.feed(data, made.t_ns) if isinstance(m, UwbRanges)]
    assert len(heard) >= 3
    gaps = [b.t_rx_ns - a.t_rx_ns for a, b in pairwise(heard)]
    assert set(gaps) == {1_000_000_000}
    anchors = {a.id: np.array([a.north_m, a.east_m, a.down_m]) for a in SITE.anchors}
    for message in heard:
        misfit = [
            sum((np.linalg.norm(tag - anchors[r.anchor]) - r.range_m) ** 2 for r in message.ranges) for _, tag in places
        ]
        measured_ns = places[int(np.argmin(misfit))][0]
        assert (message.t_rx_ns - measured_ns) * 1e-9 == pytest.approx(latency_s, abs=0.021)


def test_a_silent_tag_is_silent():
    made = world()
    made.silent_uwb = True
    for k in range(500):
        if k % 10 == 0:
            talk(made)
        assert made.step().uwb == b""


@pytest.mark.parametrize("name", ["aritra", "twin"])
def test_overrides_move_the_boat(name):
    """Armed and in MANUAL, thrust ahead on every thruster of the file; the wire carries heartbeats and an IMU."""
    made, codec, encoder = world(5, name), MavlinkCodec(), MavlinkEncoder(1, 191, 1, 1)
    n = len(made.vessel.thrusters)
    messages = []
    for k in range(1500):
        if k % 10 == 0:
            pwm = 1500 if k < 500 else 1600
            made.mavlink(encoder.override(lease((pwm,) * n)), PEER)
        if k % 100 == 50 and not made.rover.vehicle.modes.armed:
            made.mavlink(encoder.set_mode(0), PEER)
            made.mavlink(encoder.arm(), PEER)
        for _, data in made.step().mavlink:
            messages += codec.feed(data, made.t_ns)
        if k == 480:
            assert np.hypot(*made.plant.motion.x[3:5]) < 0.01
    assert made.plant.motion.x[3] > 0.3, "under way"
    assert made.truth().f_n == tuple(made.plant.motion.x[6:]) and len(made.truth().f_n) == n
    kinds = {type(m) for m in messages}
    assert Heartbeat in kinds and ImuSample in kinds


def test_pulses_that_are_off_are_no_thrust():
    """Before the gate runs the outputs hold no pulse at all (0 us)."""
    made = world()
    made.step()
    for _ in range(100):
        made.step()
    assert not made.plant.motion.x[6:].any()


@pytest.mark.parametrize("seconds", [100, pytest.param(3600, marks=[pytest.mark.long, pytest.mark.matrix])])
def test_time_flies(seconds):
    """An hour without a companion takes about a minute of computing."""
    made, started = world(7, **ROUGH), time.perf_counter()
    for _ in range(seconds * 100):
        made.step()
    print(f"{seconds} s of world in {time.perf_counter() - started:.1f} s")
    assert made.t_ns == seconds * 10**9 and np.isfinite(made.plant.motion.x).all()


def test_a_current_turns_from_the_start_of_the_boat_on_whatever_the_clock_says() -> None:
    turning = Weather(V_c_m_s=0.1, beta_c_deg=90.0, turn_deg_s=0.3)
    made = [WorldSetup(boat("aritra"), SITE, start=START, weather=turning, boot_ns=boot_ns) for boot_ns in (0, 10**13)]
    early, late = (Afloat(one, 1) for one in made)
    assert early.advance((1500,) * 4).beta_c_deg == late.advance((1500,) * 4).beta_c_deg == 90.0
