"""Absurd numbers: each number of vessel, run and site file has a range; beyond it is refused with file, key, range."""

import re
import tomllib
from copy import deepcopy
from itertools import pairwise

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from companion.boat.load_run import EXAMPLES, load_setup, warnings
from companion.core.configuration.run_file import load_run
from companion.core.configuration.site_file import load_site
from companion.core.configuration.tables import ConfigError
from companion.core.geometry.fence import MOST_CORNERS
from companion.core.guidance.missions.mission import MissionErrors, parse
from companion.core.model.load_vessel import load_vessel

READ = {"boats/aritra.toml": load_vessel, "boats/cse1.toml": load_vessel, "boats/twin.toml": load_vessel,
        "sites/basin.toml": load_site, "aritra.toml": load_run, "on-board.toml": load_run}  # fmt: skip
EXTRA = {
    "aritra.toml": {"vision": {"rate_Hz": 10.0}, "log": {"folder": "x", "quota_MB": 100.0},
                    "telemetry": {"connect": ["tcp/a:1"], "rate_Hz": 10.0, "history_s": 60.0},
                    "battery": {"low_V": 14.0, "critical_V": 13.2, "low_percent": 30.0, "critical_percent": 20.0}},
    "boats/aritra.toml": {"model_error": {"X_sigma_N": 1.0, "Y_sigma_N": 1.0, "N_sigma_N_m": 1.0, "source": "assumed"}},
}  # fmt: skip
"""Tables that the examples leave out."""


def tables(name):
    return {**tomllib.loads((EXAMPLES / name).read_text()), **deepcopy(EXTRA.get(name, {}))}


def numbers(node, at=()):
    """Paths of all numbers in a file, dict keys and list indices."""
    if isinstance(node, dict | list):
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            yield from numbers(value, (*at, key))
    elif isinstance(node, int | float) and not isinstance(node, bool):
        yield at


def changed(name, at, value):
    """The file with another value at a place, as text."""
    data = tables(name)
    *way, last = at
    node = data
    for key in way:
        node = node[key]
    node[last] = type(node[last])(value)
    return tomli_w.dumps(data)


def spelled(at):
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in at).removeprefix(".")


ALL = [(name, at) for name in READ for at in numbers(tables(name)) if at != ("format",)]


@pytest.mark.parametrize("name", READ)
def test_the_examples_load_with_all_their_tables(name):
    READ[name](tomli_w.dumps(tables(name)), name=name)


@pytest.mark.parametrize(("name", "at"), ALL, ids=[f"{name}:{spelled(at)}" for name, at in ALL])
@pytest.mark.parametrize("absurd", [1e12, -1e12])
def test_no_number_of_any_file_may_be_absurd(name, at, absurd):
    with pytest.raises(ConfigError) as caught:
        READ[name](changed(name, at, absurd), name=f"my/{name}")
    told = str(caught.value)
    assert told.startswith(f"my/{name}: {spelled(at)}: expected "), told
    assert re.search(r"(expected \S+ to \S+|more than|at least|at most|less than)", told) and "found" in told, told


@pytest.mark.parametrize(
    ("name", "at", "absurd"),
    [
        ("boats/aritra.toml", ("inertia", "mass_kg"), 1e-6),
        ("boats/aritra.toml", ("inertia", "I_z_kg_m2"), 1e-9),
        ("boats/aritra.toml", ("thrusters", 0, "force_max_N"), 0.0),
        ("boats/aritra.toml", ("propulsion", "nominal_voltage_V"), 0.001),
        ("boats/aritra.toml", ("propulsion", "lag_s"), 1e-9),
        ("boats/aritra.toml", ("force_maps", "t200", "k_ahead_N_s2"), 1e-12),
        ("boats/aritra.toml", ("force_maps", "t200", "ahead", "q"), 1e-9),
        ("boats/cse1.toml", ("force_maps", "voith_schneider", "ahead_N"), 1e-9),
        ("boats/aritra.toml", ("sensors", "uwb", "range_sigma_m"), 1e-12),
        ("boats/aritra.toml", ("hull", "length_m"), 1e-3),
        ("aritra.toml", ("battery", "low_V"), 0.014),
        ("aritra.toml", ("control", "plan_deadline_s"), 1e-9),
    ],
)
def test_numbers_that_are_too_small_are_refused_too(name, at, absurd):
    with pytest.raises(ConfigError, match=rf"^x: {re.escape(spelled(at))}: expected \S+ to \S+, found {absurd:g}"):
        READ[name](changed(name, at, absurd), name="x")


def test_a_number_that_no_float_holds_is_refused_by_its_key():
    text = (EXAMPLES / "boats/aritra.toml").read_text().replace("mass_kg = 45.0", f"mass_kg = {10**400}")
    with pytest.raises(ConfigError, match=r"inertia\.mass_kg: expected 0\.1 to 100000, found a number beyond"):
        load_vessel(text, name="x")


@pytest.mark.parametrize(
    "at", [("inertia", "x_g_m"), ("thrusters", 2, "y_m"), ("sensors", "imu", "z_m"), ("sensors", "uwb", "x_m")]
)
def test_a_place_far_beyond_the_hull_is_refused(at):
    with pytest.raises(ConfigError, match=re.escape(f"{spelled(at)}: expected -3 to 3, found -20: a hull of 1.47 x")):
        load_vessel(changed("boats/aritra.toml", at, -20.0), name="boats/aritra.toml")


@pytest.mark.parametrize(("mass_kg", "found"), [(1000.0, "1000"), (0.5, "0.5")])
def test_a_mass_that_the_hull_cannot_have_is_refused(mass_kg, found):
    text = changed("boats/aritra.toml", ("inertia", "mass_kg"), mass_kg)
    with pytest.raises(ConfigError, match=rf"inertia.mass_kg: expected 1.13 to 339, found {found}: a hull of 1.47"):
        load_vessel(text, name="x")


def basin(fence=None, anchors=None):
    data = tables("sites/basin.toml")
    if fence is not None:
        data["fence"] = fence
    if anchors is not None:
        places = [dict(zip(("north_m", "east_m", "down_m"), place, strict=True)) for place in anchors]
        data["anchors"] = [{"id": str(i), **place, "source": "assumed"} for i, place in enumerate(places)]
    return tomli_w.dumps(data)


@pytest.mark.parametrize(
    ("anchors", "says"),
    [
        ([(5.0, 5.0, -2.5)] * 4, r"anchors\[1\]: '1' stands where '0' does"),
        ([(5.0, 5.0, -1.0), (5.0, 5.0, -2.0), (5.1, 5.2, -3.0)], r"anchors: all stand within 0.5 m of one another"),
    ],
)
def test_anchors_that_give_no_position_are_refused(anchors, says):
    with pytest.raises(ConfigError, match=f"^s.toml: {says}"):
        load_site(basin(anchors=anchors), name="s.toml")


@pytest.mark.parametrize(
    ("anchors", "says"),
    [
        ([(0.0, 0.0, -2.5), (30.0, 0.0, -2.5)], "2 anchors in the site file: a start from ranges needs 3"),
        ([(0.0, 0.0, -2.5), (15.0, 15.0, -2.5), (30.0, 30.2, -2.5)], "the anchors stand in a line"),
        ([(0.0, 13.0, -2.5), (0.0, 15.0, -2.5), (1.5, 16.0, -2.5)], r"error grows \d+\.\d times in the position"),
        ([(0.0, 0.0, -2.5), (30.0, 0.0, 2.5), (30.0, 30.0, 2.5)], r"anchors below the water \(1, 2\)"),
    ],
)
def test_anchors_that_give_a_poor_position_are_warned_of(tmp_path, anchors, says):
    for name in ("boats/aritra.toml", "missions/square.toml", "aritra.toml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text((EXAMPLES / name).read_text())
    (tmp_path / "sites").mkdir()
    (tmp_path / "sites" / "basin.toml").write_text(basin(anchors=anchors))
    (text,) = warnings(load_setup(tmp_path / "aritra.toml"))
    assert re.search(says, text)


def ring(count):
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return [[15 + 14 * float(np.cos(a)), 15 + 14 * float(np.sin(a))] for a in angles]


def test_a_fence_may_have_so_many_corners_and_no_more():
    assert len(load_site(basin(ring(MOST_CORNERS)), name="s").fence) == MOST_CORNERS
    with pytest.raises(ConfigError, match=rf"s: fence: 3000 corners; expected at most {MOST_CORNERS}: leave out"):
        load_site(basin(ring(3000)), name="s")


def test_the_fences_of_a_mission_may_have_as_many_together():
    head = 'name = "m"\n[[waypoints]]\nnorth_m = 1.0\neast_m = 1.0\n'
    fence = "[[fences]]\ninclusion = true\npolygon = {}\n"
    half = fence.format(ring(MOST_CORNERS // 2))
    assert len(parse(head + 2 * half, "toml").fences) == 2
    with pytest.raises(MissionErrors, match=r"fences\[2\]: 150 corners; the fences of a mission may have 300 together"):
        parse(head + 3 * half, "toml")


def test_a_fence_that_encloses_nothing_is_refused():
    with pytest.raises(ConfigError, match=r"s: fence: encloses 0.01 m\^2; expected at least 1"):
        load_site(basin([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]]), name="s")


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=3, max_size=12))
def test_crossings_are_those_that_a_plain_look_at_all_pairs_finds(corners):
    """Whole numbers, so that edges touch, run along each other and have no length."""
    fence = [[float(a), float(b)] for a, b in corners]
    edges, k = list(pairwise([*corners, corners[0]])), len(corners)
    pairs = [(i, j) for i in range(k) for j in range(i + 2, k - (i == 0))]
    crossed = any(a == b for a, b in edges) or any(meet(*edges[i], *edges[j]) for i, j in pairs)
    try:
        load_site(basin(fence), name="s")
        refused = False
    except ConfigError as error:
        refused = "touch" in str(error)
        assert refused or "encloses" in str(error)
    assert refused == crossed


def meet(a, b, c, d):
    """Whether two segments meet: solved for their parameters in whole numbers, or as intervals on one line."""
    (ux, uy), (vx, vy), (wx, wy) = (b[0] - a[0], b[1] - a[1]), (d[0] - c[0], d[1] - c[1]), (c[0] - a[0], c[1] - a[1])
    det = ux * vy - uy * vx
    if det:
        s, t = (wx * vy - wy * vx) / det, (wx * uy - wy * ux) / det
        return 0 <= s <= 1 and 0 <= t <= 1
    if wx * uy - wy * ux or (c == d and wx * vy - wy * vx):
        return False
    along = [(p[0] - a[0]) * ux + (p[1] - a[1]) * uy for p in (c, d)]
    return min(along) <= ux * ux + uy * uy and max(along) >= 0
