"""A synthetic drive: a boat goes round a square, written by the real recorder on a stepped clock."""

import math
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from companion.boat.recorder import Recorder
from companion.core import messages as m
from companion.logs.metadata import log_metadata

ANCHORS = {"A1": (-2.0, -2.0), "A2": (12.0, -2.0), "A3": (12.0, 12.0), "A4": (-2.0, 12.0)}
SITE = """
name = "pond"
lat_deg = 0.0
lon_deg = 0.0
fence = [[-2.0, -2.0], [12.0, -2.0], [12.0, 12.0], [-2.0, 12.0]]
source = "assumed"
""" + "".join(
    f'[[anchors]]\nid = "{name}"\nnorth_m = {north}\neast_m = {east}\ndown_m = 0.0\nsource = "assumed"\n'
    for name, (north, east) in ANCHORS.items()
)
WALL_OFFSET_NS = 1_790_000_000_000_000_000


class StepClock:
    """A clock that stands still until told to go."""

    def __init__(self, t_ns: int = 5_000_000_000):
        self.t_ns = t_ns

    def __call__(self) -> int:
        return self.t_ns


@pytest.fixture
def step_clock() -> StepClock:
    return StepClock()


@pytest.fixture
def drive_log(tmp_path: Path) -> Callable[..., Path]:
    """`drive_log(seconds)` writes a log of a drive (seed 7) and returns its path."""

    def write(seconds: float = 20.0, **options: int) -> Path:
        path = tmp_path / "drive.mcap"
        files = {"vessel.toml": 'name = "synthetic"\n', "site.toml": SITE}
        metadata = log_metadata("synthetic", files)
        attachments = {name: text.encode() for name, text in files.items()}
        clock, dice = StepClock(), random.Random(7)
        with Recorder(
            path,
            metadata,
            clock,
            wall_offset_ns=WALL_OFFSET_NS,
            attachments=attachments,
            background=False,
            **options,
        ) as recorder:
            for index in range(int(seconds * 10)):
                _second_tenth(recorder, clock, index, dice)
                clock.t_ns += 100_000_000
            recorder.record(m.Alert(t_ns=clock.t_ns, level="warning", text="thruster 2 near its limit"))
        return path

    return write


def _second_tenth(recorder: Recorder, clock: StepClock, index: int, dice: random.Random) -> None:
    t, t_ns = index / 10, clock.t_ns
    leg, along = int(t / 25) % 4, (t % 25) * 0.4
    corners, headings = ((0, 0), (10, 0), (10, 10), (0, 10)), (0.0, math.pi / 2, math.pi, -math.pi / 2)
    psi = headings[leg]
    north = corners[leg][0] + along * math.cos(psi)
    east = corners[leg][1] + along * math.sin(psi)
    wobble, phase = 0.12 * math.sin(t), "idle" if index < 10 else "leg"
    n, e = north + wobble * math.sin(psi), east + wobble * math.cos(psi)
    body = {"u_m_s": 0.4 + 0.02 * math.sin(t / 2), "v_m_s": 0.03 * math.cos(t), "r_rad_s": 0.0}
    recorder.record(m.Tick(t_ns=t_ns, index=index, lateness_ns=abs(int(dice.gauss(2e5, 4e5)))))
    recorder.record(m.LoopTiming(t_ns=t_ns, index=index, lateness_ms=0.2, imu_to_override_ms=dice.gauss(9, 2)))
    recorder.record_raw("mavlink", "rx", bytes(dice.randbytes(60)))
    recorder.record(m.GroundTruth(t_ns=t_ns, north_m=n, east_m=e, psi_rad=psi + 0.02, **body, f_n=(1.0,) * 4))
    noisy = {name: value + dice.gauss(0, 0.015) for name, value in body.items()}
    recorder.record(
        m.StateEstimate(
            t_ns=t_ns, north_m=n + dice.gauss(0, 0.03), east_m=e + dice.gauss(0, 0.03), psi_rad=psi, **noisy,
            covariance=(0.01,) * 36, accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0,
            anchor_bias_m={"A1": 0.02}, disturbance_n=(0.0, 0.0, 0.0), health="healthy", reason="",
        )
    )  # fmt: skip
    recorder.record(
        m.GuidanceReference(
            t_ns=t_ns, phase=phase, leg=leg, waypoints_passed=leg, x_e_m=along, y_e_m=wobble,
            path_angle_rad=psi, psi_ref_rad=psi, u_ref_m_s=0.4, north_ref_m=north, east_ref_m=east,
        )
    )  # fmt: skip
    recorder.record(
        m.PlanResult(
            t_ns=t_ns, index=index, status="ok", reason="", solve_time_s=abs(dice.gauss(2e-3, 5e-4)),
            iterations=3, cost=1.0, f_n=((1.0, 1.0, 1.0, 1.0),) * 3, x=((0.0,) * 10,) * 4,
        )
    )  # fmt: skip
    source = "shifted_plan" if index % 50 in (30, 31, 32) else "plan"
    pwm_us = tuple(1500 + int(80 * math.sin(t / 3 + k) + dice.gauss(0, 6)) for k in range(4))
    recorder.record(
        m.OverrideLease(
            t_ns=t_ns, index=index, channels=(1, 2, 3, 4), pwm_us=pwm_us, valid_for_s=0.3, source=source,
            reason="", f_command_n=(1.0,) * 4,
        )
    )  # fmt: skip
    if index % 5 == 0:
        _uwb(recorder, t_ns, n, e, dice)


def _uwb(recorder: Recorder, t_ns: int, north_m: float, east_m: float, dice: random.Random) -> None:
    for anchor in ANCHORS:
        d2 = dice.expovariate(0.5) if dice.random() < 0.95 else 40.0
        recorder.record(
            m.Innovation(t_ns=t_ns, sensor=f"range {anchor}", innovation=(0.1,), S=(0.01,), d2=d2, accepted=d2 < 12)
        )
    ranges = tuple(
        m.AnchorRange(anchor=a, range_m=math.dist((north_m, east_m), place) + dice.gauss(0, 0.1))
        for a, place in ANCHORS.items()
    )
    recorder.record(m.UwbRanges(t_ns=t_ns - 20_000_000, t_rx_ns=t_ns, tag="T", ranges=ranges))
    recorder.record(
        m.UwbPosition(
            t_ns=t_ns - 30_000_000, t_rx_ns=t_ns, tag="T", x_m=east_m + dice.gauss(0, 0.1),
            y_m=north_m + dice.gauss(0, 0.1), z_m=0.0, quality=80,
        )
    )  # fmt: skip
