"""Rows of the kill matrix (scripts/evidence safe --only kill --full) in real processes, and its judge, which condemns.

Times in the everyday rows count from the last override that reached the autopilot, by the simulator's own clock, so
that a busy machine may hold a datagram up; the evidence counts from the fault.
"""

from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.evidence.safe.cases import CASES, COMPANION_S, UNSEEN_S
from tests.evidence.safe.kill import tried
from tests.evidence.safe.pen import Override, Pen, Step
from tests.evidence.safe.trial import ALL_RULES, Trial
from tests.evidence.safe.wire import delayed, duplicated, garbled, reordered, silent

pytestmark = pytest.mark.real_time

BY_NAME = {f"{case.group}: {case.name}": case for case in CASES}
EVERYDAY = (
    "companion: SIGKILL, gate, no receiver",
    "companion: SIGSTOP, gate, no receiver",
    "link: silent both ways",
    "UWB: silent",
)
TOLD = {"companion: log disk hangs": "the disk hangs"}
"""Rows in which the boat drives on and a person must hear of it."""
NEUTRAL = [65535] * 18
S = 1_000_000_000


@pytest.mark.parametrize("names", [EVERYDAY[:3], pytest.param(EVERYDAY[3:], marks=pytest.mark.long)], ids="-".join)
def test_everyday_rows(names):
    with ThreadPoolExecutor(len(names)) as pool:
        rows = list(pool.map(lambda name: tried(BY_NAME[name]), names))
    for name, row in zip(names, rows, strict=True):
        print(row.markdown())
        assert row.thrusters == "neutral", name
        assert row.time_s <= (UNSEEN_S if name.startswith("UWB") else 2.0), row.markdown()
        if not name.startswith("UWB"):
            assert row.after_override_s <= COMPANION_S, f"{name}: the autopilot alone decides this"
        assert row.broken == dict.fromkeys(ALL_RULES, 0), name


OTHERS = [name for name in BY_NAME if name not in EVERYDAY]
TOGETHER = [OTHERS[k : k + 3] for k in range(0, len(OTHERS), 3)]


@pytest.mark.long
@pytest.mark.parametrize("names", TOGETHER, ids=" + ".join)
@pytest.mark.matrix
def test_the_other_rows(names):
    with ThreadPoolExecutor(len(names)) as pool:
        rows = list(pool.map(lambda name: tried(BY_NAME[name]), names))
    for name, row in zip(names, rows, strict=True):
        print(row.markdown())
        assert row.broken == dict.fromkeys(ALL_RULES, 0), name
        assert row.safe, row.markdown()
        assert TOLD.get(name, "") in row.told, name


def _channels(**pulses):
    channels = [1500] * 4 + [65535] * 4 + [1500] * 4 + [0] * 6
    for name, value in pulses.items():
        channels[int(name[1:]) - 1] = value
    return Override(0, tuple(channels))


@pytest.mark.parametrize(
    ("override", "outside", "elsewhere"),
    [
        (_channels(), 0, 0),
        (_channels(c9=1100, c12=1900), 0, 0),
        (_channels(c9=1099), 1, 0),
        (_channels(c9=1901, c10=0, c11=65534), 1, 0),
        (_channels(c1=1501), 0, 1),
        (_channels(c1=0, c2=65535), 0, 0),
        (_channels(c5=1500), 0, 1),
        (_channels(c8=65534), 0, 1),
        (_channels(c13=1500), 0, 1),
        (_channels(c13=65534), 0, 1),
    ],
)
def test_the_judge_knows_overrides_that_may_not_be(override, outside, elsewhere):
    assert (override.outside(), override.elsewhere()) == (outside, elsewhere)


def _trial(tmp_path, *thrusters_us):
    """A trial that was only written down: one step a second."""
    trial = Trial(tmp_path)
    trial.pen.steps = [Step(n * S, (*pulses, *[0] * 12), True, 0, 0.0, 0.0) for n, pulses in enumerate(thrusters_us)]
    return trial


def test_the_judge_knows_thrusters_that_still_turn(tmp_path):
    rest, turning = (1500,) * 4, (1500, 1700, 1500, 1500)
    trial = _trial(tmp_path, turning, turning, rest, rest, rest)
    assert trial.to_rest_s(0, 4 * S) == pytest.approx(1.01)
    assert trial.thrusters(4 * S) == "neutral"
    trial = _trial(tmp_path, turning, rest, rest, turning, rest, rest)
    assert trial.to_rest_s(0, 5 * S) == pytest.approx(3.01), "the last motion counts, not the first rest"
    trial = _trial(tmp_path, turning, rest, turning)
    assert trial.to_rest_s(0, 2 * S) == float("inf")
    trial = _trial(tmp_path, turning, turning, turning)
    assert trial.thrusters(2 * S) == "stay at 1500 1700 1500 1500 us"
    trial = _trial(tmp_path, turning, (1500, 1701, 1500, 1500))
    assert trial.thrusters(1 * S) == "drive on"
    assert _trial(tmp_path, turning, (0,) * 4, (0,) * 4, (0,) * 4).thrusters(3 * S) == "no pulse"


def test_the_pen_is_read_while_it_is_written(tmp_path):
    path = tmp_path / "pen.txt"
    pen = Pen(path)
    assert not pen.read().steps
    line = f"s 10 {' '.join(['1500'] * 16)} 1 0 8.000 9.000\n"
    path.write_text(line + line[:20])
    assert pen.read().steps == [Step(10, (1500,) * 16, True, 0, 8.0, 9.0)]
    path.write_text(line + line + f"o 20 {' '.join(map(str, NEUTRAL))}\n")
    assert len(pen.read().steps) == 2 and pen.overrides == [Override(20, tuple(NEUTRAL))]


def test_what_a_wire_does():
    data = bytes(range(200))
    assert list(silent()("to_autopilot", data)) == [] == list(silent("to_companion")("to_companion", data))
    assert list(silent("to_companion")("to_autopilot", data)) == [(0.0, data)]
    ((_, bad),) = garbled(1, 0.2)("to_autopilot", data)
    assert len(bad) == len(data) and 10 < sum(a != b for a, b in zip(bad, data, strict=True)) < 80
    assert [d for _, d in duplicated("to_autopilot", data)] == [data, data]
    shuffled = reordered(1)
    late = [next(iter(shuffled("to_autopilot", data)))[0] for _ in range(20)]
    assert late != sorted(late) and 0.1 < max(late) <= 0.25
    assert list(delayed(0.5)("to_autopilot", data)) == [(0.5, data)]
