"""Random faults at every wire of the whole App: neutral when it is due, a lease every tick, ours alone on the wire.

`scripts/evidence safe` runs 200 sequences. A failing one is shrunk; hypothesis prints it, and `FaultBench` replays it.
"""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, seed, settings
from msgspec.structs import replace

from companion.core.estimation import health
from companion.core.messages import ModeStatus, OverrideLease
from companion.core.pilot import annunciator, autopilot_state, manual_control
from companion.core.pilot.monitors import battery, output_monitor, override_monitor
from companion.core.pilot.pilot import Pilot
from drivers.mavlink.encode import MavlinkEncoder
from tests.support.fault_fixture import FaultBench
from tests.support.fault_oracle import judge
from tests.support.faults import Fault, Sequence, sequences

SEED = 20261


def played(folder, beginning, *faults, receiver=False, real=False):
    told = Sequence(beginning, receiver, real, tuple(Fault(*f) for f in faults))
    return FaultBench(folder / f"{len(list(folder.iterdir()))}.mcap", told).play()


@seed(SEED)
@settings(max_examples=5, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow])
@given(told=sequences(3, (0.2, 1.0, 3.6)))
def test_whatever_happens_neutral_comes_when_it_is_due(told, tmp_path_factory):
    assert judge(FaultBench(tmp_path_factory.mktemp("faults") / "run.mcap", told).play()) == []


@pytest.mark.long
def test_the_boat_of_these_tests_drives_in_every_mode_and_the_real_controller_may_plan(tmp_path):
    for beginning in ("auto", "hold", "manual", "excitation"):
        run = played(tmp_path, beginning, ("battery", "13.8", 1.0, 0.2), receiver=True, real=beginning == "auto")
        assert judge(run) == []
        assert {m.mode for m in run.of(ModeStatus)} == {"idle", "starting" if beginning != "manual" else "locked",
                                                        beginning}  # fmt: skip
        assert len({outputs for _, outputs, _ in run.heard.esc}) > 3, "its thrusters turned"


@pytest.mark.long
def test_the_same_story_is_the_same_run(tmp_path):
    told = ("auto", ("solver", "late 0.07", 0.3, 1.0), ("down", "corrupt", 0.3, 3.6), ("lag", "0.6", 1.0, 0.0))
    first, again = (
        [(t, bytes(m.get_msgbuf())) for t, m in played(tmp_path, *told, real=True).sent if m.get_msgbuf()]
        for _ in range(2)
    )
    assert first == again and len(first) > 100


# --- the oracle sees a boat that is at fault: each way of spoiling the product is found -----------------


def no_patience_limit(patch):
    patch.setattr(autopilot_state, "HEARTBEAT_LOST_NS", 10**11)


def no_ears_for_disarming(patch):
    """Neither in heartbeats nor in texts nor at the outputs."""
    patch.setattr(autopilot_state, "changes", lambda *_: {})
    patch.setattr(autopilot_state, "DISARMED_TEXT", "nobody says this")
    patch.setattr(output_monitor, "STILL_ECHOES", 10**6)


def no_eyes_for_hands(patch):
    patch.setattr(override_monitor, "MOVED_US", 10**6)


def sticks_for_ever(patch):
    patch.setattr(manual_control, "silent", lambda *_: None)


def packs_for_ever(patch):
    patch.setattr(battery, "LIMIT_NS", 10**12)


def blind_for_ever(patch):
    patch.setattr(annunciator, "degraded_too_long", lambda *_: None)
    patch.setattr(health, "TURNS_UNSEEN_S", 1e9)


def another_channel(patch):
    override = MavlinkEncoder.override

    def wider(self, lease):
        return override(self, replace(lease, channels=(*lease.channels, 5), pwm_us=(*lease.pwm_us, 1500)))

    patch.setattr(MavlinkEncoder, "override", wider)


def a_lease_now_and_then(patch):
    step = Pilot.step

    def forgets(self, *given):
        state, outputs = step(self, *given)
        return state, [o for o in outputs if not (isinstance(o, OverrideLease) and o.index % 40 > 36)]

    patch.setattr(Pilot, "step", forgets)


@pytest.mark.parametrize(
    ("spoil", "beginning", "fault", "receiver", "says"),
    [
        (no_patience_limit, "auto", ("cable", "silent", 0.3, 6.0), False, "no heartbeat"),
        (no_ears_for_disarming, "hold", ("gcs", "disarm", 0.3, 0.0), False, "disarmed"),
        (no_ears_for_disarming, "auto", ("gcs", "hold", 0.3, 0.0), False, "mode 4"),
        (no_eyes_for_hands, "auto", ("hand", "moved", 0.3, 1.0), True, "a hand moved"),
        (sticks_for_ever, "manual", ("sticks", "gone", 0.3, 0.0), False, "sound input from the sticks"),
        (packs_for_ever, "auto", ("battery", "12.5", 0.3, 20.0), False, "pack is critical"),
        (blind_for_ever, "auto", ("uwb", "silent", 0.3, 22.0), False, "no UWB"),
        (blind_for_ever, "auto", ("imu", "frozen", 0.3, 22.0), False, "no IMU"),
        (blind_for_ever, "auto", ("imu", "nan", 0.3, 22.0), False, "no heading"),
        (another_channel, "idle", ("battery", "0", 0.0, 0.2), False, "channel 5 is not ours"),
        (a_lease_now_and_then, "auto", ("battery", "13.8", 3.0, 0.2), False, "no override for"),
    ],
)
@pytest.mark.long
def test_a_spoilt_boat_is_found_out(monkeypatch, tmp_path, spoil, beginning, fault, receiver, says):
    spoil(monkeypatch)
    assert any(says in found for found in judge(played(tmp_path, beginning, fault, receiver=receiver)))
