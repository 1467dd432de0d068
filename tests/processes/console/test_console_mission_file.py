"""What the page makes of a drawn mission, without a boat: its file, read by the boat's loader; its checks, against the
boat's fence and by sampling. Missions and fences are random, seeds 0 to 39."""

import math
import random
from itertools import pairwise

import numpy as np
import pytest

from companion.core.geometry.fence import Fence, clearance, crossing
from companion.core.guidance.missions.mission import parse
from tests.support.console_fixture import Page

pytestmark = pytest.mark.real_time

SEEDS = range(40)
NAMES = (
    "pier",
    'a "quoted" \\ name',
    "tab\tand\nline",
    "\x7f\x00",
    "Fjord ø 测试 🚤",
    "\ud83d",
    "",
    "x" * 200,
    "'''",
    "# no",
)


def mission(seed):
    """Waypoints apart from each other, as a hand may have drawn them, with odd names and numbers."""
    rng = random.Random(seed)
    some = lambda low, high: rng.choice((None, round(rng.uniform(low, high), rng.randint(0, 6))))  # noqa: E731
    waypoints = [
        {
            "north_m": rng.uniform(-500, 500) + 10 * k,
            "east_m": rng.choice((0, -0.0, 1e-7, 12.3456789, rng.uniform(-1e4, 1e4))) + 1000 * k,
            "speed_m_s": some(1, 3),
            "acceptance_m": some(1, 5),
        }
        for k in range(rng.randint(1, 30))
    ]
    triangle = [[0.0, 0.0], [1e3 * rng.random(), 7.0], [3.0, 1e-3 + rng.random()]]
    return {
        "name": NAMES[seed % len(NAMES)],
        "end_heading_deg": some(-180, 360),
        "waypoints": waypoints,
        "fences": [{"inclusion": bool(seed % 2), "polygon": triangle}] if seed % 3 == 0 else [],
    }


def star(rng, corners):
    """A polygon that does not cross itself, whatever its shape."""
    angles = sorted(rng.uniform(0, 2 * math.pi) for _ in range(corners))
    polygon = [(rng.uniform(5, 30) * math.cos(a), rng.uniform(5, 30) * math.sin(a)) for a in angles]
    return polygon if crossing(tuple(polygon)) is None else star(rng, corners)


def least(fence, a, b):
    """Least distance to the fence on a leg between places that are inside [m], every 3 cm; None: one is not."""
    if min(fence.clearance(*a), fence.clearance(*b)) < 0:
        return None
    along = np.linspace(a, b, 2000)
    return min(clearance(np.array(fence.within[0]), along).min(), -clearance(np.array(fence.without[0]), along).max())


@pytest.fixture
def page(console, browser):
    made = Page(browser, console)
    yield made
    assert made.unexpected() == []
    made.context.close()


def test_every_file_of_the_page_is_read_by_the_boats_loader(page):
    drawn = [mission(seed) for seed in SEEDS]
    texts = page.page.evaluate(
        """async (drawn) => { const { Plan, toToml } = await import('/web/mission/plan.js');
        return drawn.map((m) => { const plan = new Plan(); plan.take(m); return toToml(plan.now, m.name); }); }""",
        drawn,
    )
    for made, text in zip(drawn, texts, strict=True):
        read = parse(text, "toml")
        assert len(read.path.waypoints) == len(made["waypoints"]) and 0 < len(read.name) <= 60
        for w, given in zip(read.path.waypoints, made["waypoints"], strict=True):
            assert (w.north_m, w.east_m) == pytest.approx((given["north_m"], given["east_m"]), abs=0.0006)
            assert w.speed_m_s == pytest.approx(given["speed_m_s"], abs=6e-5)
            assert w.acceptance_m == pytest.approx(given["acceptance_m"], abs=0.0006)
        end = made["end_heading_deg"]
        assert (read.end_heading_rad is None) == (end is None)
        assert end is None or math.degrees(read.end_heading_rad) == pytest.approx(end, abs=6e-4)
        assert [f.inclusion for f in read.fences] == [f["inclusion"] for f in made["fences"]]


@pytest.mark.long
def test_the_pages_distance_to_the_fence_is_the_boats_and_legs_that_leave_it_are_seen(page):
    cases, wanted = [], []
    for seed in SEEDS:
        rng = random.Random(seed)
        within, without = star(rng, rng.randint(3, 12)), [(n / 9, e / 9) for n, e in star(rng, 5)]
        fence = Fence((tuple(within),), (tuple(without),))
        places = [(rng.uniform(-20, 20), rng.uniform(-20, 20)) for _ in range(50)]
        cases.append({"within": [within], "without": [without], "places": places})
        rooms = [fence.clearance(*p) for p in places]
        wanted.append((rooms, [least(fence, *leg) for leg in pairwise(places)]))
    told = page.page.evaluate(
        """async (cases) => { const { clearance, leaves } = await import('/web/mission/checks.js');
        return cases.map((c) => [c.places.map((p) => clearance(c, p)),
          c.places.slice(1).map((p, k) => leaves(c, c.places[k], p))]); }""",
        cases,
    )
    seen = {True: 0, False: 0}
    for (rooms, legs), (page_rooms, page_legs) in zip(wanted, told, strict=True):
        assert page_rooms == pytest.approx(rooms, abs=1e-9)
        for room_m, leaving in zip(legs, page_legs, strict=True):
            if room_m is not None and abs(room_m) > 0.05:  # nearer to the fence than the sampling is fine
                assert leaving == (room_m < 0)
                seen[leaving] += 1
    assert min(seen.values()) > 10, seen
