"""Two autopilots with one system id on one wire: neither is ours for sure, and both would hear us."""

from companion.boat.start_interlock import StartInterlock
from companion.core.preflight.wiring import Companion
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.session import TWINS, MavlinkSession
from tests.drivers.mavlink.mavlink_autopilot import Sender

S = 1_000_000_000


def heard(uptimes_ms: list[int], period_ns: int) -> tuple[MavlinkCodec, list[str]]:
    """Attitudes with these stamps, so far apart, and what the session says of them."""
    codec, sender, said = MavlinkCodec(), Sender(), []
    session = MavlinkSession(codec, {})
    for k, t_ms in enumerate(uptimes_ms):
        session.step(codec.feed(sender.beat() + sender.att(t_ms), k * period_ns), k * period_ns)
        said += [alert.text for alert in session.take_alerts()]
    return codec, said


def test_two_autopilots_of_one_system_id_are_told_once_and_nothing_starts():
    turns = [t_ms for k in range(100) for t_ms in (100_000 + 50 * k, 900_000 + 50 * k)]
    codec, said = heard(turns, S // 40)
    assert said.count(TWINS) == 1 and len(said) == 3
    interlock = StartInterlock(codec, Companion((("left", 9),), (1, 2, 3, 4), system_id=1, lease_s=0.3, latency_s=0.1))
    assert interlock.refusal == TWINS and interlock.turns_away


def test_an_autopilot_that_starts_again_and_again_is_one():
    codec, said = heard([60_000, 1000, 4000, 1000, 4000, 1000, 4000, 1000], 3 * S)
    assert codec.clock.reboots == 4 and not codec.clock.twins
    assert len(said) == 4
