"""How a run of the App ends in order."""

from __future__ import annotations

from tests.companion.boat.app_fixture import S, neutral, released


def ends_in_order(bench):
    """Neutral for about a second, then disarm, then release, then nothing."""
    last = [(t, m.get_type(), m) for t, m in bench.sent if m.get_type() in ("RC_CHANNELS_OVERRIDE", "COMMAND_LONG")]
    assert released(bench.overrides[-1][1]) and last[-1][1] == "RC_CHANNELS_OVERRIDE"
    assert (last[-2][2].command, last[-2][2].param1) == (400, 0.0), "disarmed before the release"
    end_ns = last[-1][0]
    final = [pwm for t_ns, pwm in bench.overrides[:-1] if t_ns > end_ns - 0.95 * S]
    assert len(final) >= 9 and all(map(neutral, final))
    assert not bench.world.rover.vehicle.modes.armed
    assert bench.world.rover.outputs_us[:4] == (1500,) * 4
