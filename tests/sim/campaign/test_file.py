"""From a campaign file to its cases: names, draws, the grid, and what of a file is refused."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.configuration.tables import ConfigError
from sim.campaign.case_files import case_setup
from sim.campaign.cases import drawn, expand
from sim.campaign.dotted_keys import applied, flat
from sim.campaign.file import Draw, load_campaign
from sim.campaign.inputs import read_campaign
from tests.support.campaign_fixture import SHORT, campaign_file, cases_of

TEXT = """format = 1
name = "t"
kind = "missions"
seeds = {seeds}
[files]
run = "r"
[grid]
weather.V_c_m_s = {current}
[draw]
world.north_m = {{ uniform = [1.0, 2.0] }}
{more}
"""
numbers = st.floats(-100, 100).map(lambda v: v + 0.0)
many_seeds = st.lists(st.integers(0, 10**6), min_size=1, max_size=6, unique=True)
many_numbers = st.lists(numbers, min_size=1, max_size=4, unique=True)


def made(seeds, current, more="", digest="d"):
    return expand(load_campaign(TEXT.format(seeds=seeds, current=current, more=more), name="t"), {"r": digest})


@given(many_seeds, many_numbers)
def test_every_point_of_the_grid_has_every_seed_once_and_every_case_a_name(seeds, current):
    cases = made(seeds, current)
    assert sorted((c.values["weather.V_c_m_s"], c.seed) for c in cases) == sorted(
        (v, s) for v in current for s in seeds
    )
    assert len({c.id for c in cases}) == len(cases)
    assert [c.id for c in cases] == sorted(c.id for c in cases)


@given(many_seeds, many_numbers, many_seeds, many_numbers)
def test_more_seeds_and_points_leave_the_cases_that_were_there(seeds, current, more_seeds, more_current):
    before = made(seeds, current)
    after = made(list(dict.fromkeys(seeds + more_seeds)), list(dict.fromkeys(current + more_current)))
    assert {(c.id, c.seed, c.shown["world.north_m"]) for c in before} <= {
        (c.id, c.seed, c.shown["world.north_m"]) for c in after
    }


def test_a_fraction_beside_whole_numbers_leaves_their_cases():
    whole, among = made([1, 2], [0, 4]), made([1, 2], [0, 2.5, 4, 1e300])
    assert {c.id for c in whole} < {c.id for c in among} and len(among) == 8


@given(many_seeds, many_numbers)
def test_the_order_in_which_a_file_says_things_names_nothing(seeds, current):
    backwards = made(seeds[::-1], current[::-1])
    assert [c.id for c in made(seeds, current)] == [c.id for c in backwards]


@given(st.integers(0, 10**6), numbers)
def test_a_draw_is_the_seeds_alone(seed, other):
    """One more key that is drawn, another point of the grid: the same numbers."""
    (plain,) = made([seed], [0.0])
    (more,) = made([seed], [other], "weather.beta_c_deg = { uniform = [0.0, 360.0] }")
    assert plain.values["world.north_m"] == more.values["world.north_m"]
    assert more.values["weather.beta_c_deg"] / 360.0 != more.values["world.north_m"] - 1.0


def test_whatever_figures_depend_on_is_in_the_name():
    names = {
        made([1], [0.0])[0].id,
        made([2], [0.0])[0].id,
        made([1], [0.1])[0].id,
        made([1], [0.0], digest="other")[0].id,
        made([1], [0.0], "[set]\nworld.mismatch = 0.1")[0].id,
        made([1], [0.0], "[missions]\nlimit_s = 30.0")[0].id,
    }
    assert len(names) == 6


@given(st.integers(0, 10**9), st.tuples(st.floats(0.01, 10), st.floats(10.01, 1000)))
def test_draws_lie_where_they_should(seed, span):
    assert span[0] <= drawn(Draw(uniform=span), seed, "k") <= span[1]
    assert span[0] <= drawn(Draw(log_uniform=span), seed, "k") <= span[1]
    assert drawn(Draw(choice=("a", "b")), seed, "k") in ("a", "b")
    assert drawn(Draw(normal=span), seed, "k") == drawn(Draw(normal=span), seed, "k")


def test_a_normal_draw_has_its_mean_and_sigma():
    """Seeds 0 to 1999: mean within 4 standard errors."""
    values = [drawn(Draw(normal=(5.0, 2.0)), seed, "k") for seed in range(2000)]
    mean = sum(values) / 2000
    assert abs(mean - 5.0) < 4 * 2.0 / 2000**0.5
    assert 1.8 < (sum((v - mean) ** 2 for v in values) / 2000) ** 0.5 < 2.2


leaves = st.one_of(st.integers(), st.booleans(), st.text("ab", max_size=3))
names = st.text("abcxyz_", min_size=1, max_size=4)
tables = st.recursive(leaves, lambda inner: st.dictionaries(names, inner, min_size=1, max_size=3), max_leaves=8)


@given(st.dictionaries(names, tables, max_size=4))
def test_dotted_keys_put_back_what_was_flattened(document):
    assert applied({}, flat(document, "set", lambda v: not isinstance(v, dict))) == document


def test_a_step_through_a_list_is_a_name():
    boat = {"thrusters": [{"name": "port", "gain": 1.0}, {"name": "starboard"}]}
    weak = applied(boat, {"thrusters.starboard.gain": 0.5})
    assert weak["thrusters"] == [{"name": "port", "gain": 1.0}, {"name": "starboard", "gain": 0.5}]
    assert boat["thrusters"][1] == {"name": "starboard"}, "the document itself stays"
    with pytest.raises(KeyError, match=r"thrusters\.bow: nothing of that name; there are port, starboard"):
        applied(boat, {"thrusters.bow.gain": 0.5})


def test_values_arrive_where_they_belong(tmp_path):
    more = """
[set]
run.control.latency_s = 0.05
vessel.propulsion.lag_s = 0.2
truth.thrusters.rear_port.gain = 0.7
faults.dropout = 0.2
world.mismatch = 0.1
"""
    inputs, cases = read_campaign(campaign_file(tmp_path, SHORT + more))
    case = next(c for c in cases if c.values["weather.V_c_m_s"] == 0.1)
    found = case_setup(inputs.work(case))
    assert found.setup is not None and found.setup.pilot.control.latency_s == 0.05
    assert found.setup.pilot.vessel == found.vessel
    assert found.vessel.propulsion.lag_s == found.truth.propulsion.lag_s == 0.2
    gains = {t.name: t.gain for t in found.truth.thrusters}
    assert gains["rear_port"] == 0.7 and {t.gain for t in found.vessel.thrusters} == {1.0}
    assert (found.weather.V_c_m_s, found.faults.dropout, found.world.mismatch) == (0.1, 0.2, 0.1)
    assert found.weather.V_w_m_s is None, "what is not stated is not 0"
    assert found.world.north_m == case.values["world.north_m"]
    assert [w.north_m for w in found.setup.pilot.mission.path.waypoints] == [9.0, 13.0]


def test_files_can_be_points_of_the_grid(tmp_path):
    path = campaign_file(tmp_path)
    (tmp_path / "other.toml").write_text((tmp_path / "leg.toml").read_text().replace("13.0", "14.0"))
    path.write_text(SHORT.replace("[grid]", '[grid]\nfiles.mission = ["leg.toml", "other.toml"]'))
    inputs, cases = read_campaign(path)
    assert len(cases) == 16 and {c.shown["files.mission"] for c in cases} == {"leg.toml", "other.toml"}
    ends = {
        c.files["mission"][0]: case_setup(inputs.work(c)).setup.pilot.mission.path.waypoints[-1].north_m for c in cases
    }
    assert ends == {"leg.toml": 13.0, "other.toml": 14.0}
    (tmp_path / "other.toml").write_text((tmp_path / "leg.toml").read_text())
    with pytest.raises(ConfigError, match="8 cases are there twice; do two files hold the same"):
        read_campaign(path)


def test_the_examples_are_sound():
    from companion.boat.load_run import EXAMPLES

    counts = {p.stem: len(cases_of(p)) for p in (EXAMPLES / "campaigns").glob("*.toml")}
    assert counts == {"weather": 120, "wind": 20, "fits": 40, "weak_thruster": 50}


def test_every_key_is_in_the_reference():
    from pathlib import Path

    from sim.campaign import case_files as documents
    from sim.campaign.file import CampaignText, Diagnose, Identify, Missions, SeedRange
    from sim.campaign.mission import JUDGED

    page = (Path(__file__).resolve().parents[3] / "docs" / "campaign.md").read_text()
    words = set(re.findall(r"[A-Za-z_]+", " ".join(re.findall(r"`([^`]+)`", page)) + page.split("```toml")[1]))
    tables = (CampaignText, SeedRange, Missions, Identify, Diagnose, Draw, documents.WorldKeys)
    wanted = {key for table in tables for key in table.__struct_fields__} | {*JUDGED, "unleased", "farthest_m"}
    wanted |= {head for heads in documents.HEADS.values() for head in heads}
    wanted |= {f for kind in (documents.Weather, documents.UwbFaults) for f in kind.__dataclass_fields__}
    wanted -= set(documents.OF_THE_VESSEL)
    assert wanted - words == set()


def test_files_of_editors_that_begin_with_a_byte_order_mark_are_read(tmp_path):
    path = campaign_file(tmp_path)
    plain = [case.shown for case in cases_of(path)]
    for file in (path, tmp_path / "leg.toml"):
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert sorted(map(str, plain)) == sorted(str(case.shown) for case in cases_of(path))


# --- bad files -----------------------------------------------------------------------------------------------

GRID = "weather.V_c_m_s = [0.0, 0.1]"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("format = 1", "format = 2", "format: "),
        ('kind = "missions"', 'kind = "voyages"', "kind: "),
        ("seeds = { count = 4 }", "seeds = { count = 0 }", "seeds.count: "),
        ("seeds = { count = 4 }", "seeds = [1, 2, 1]", "seeds: expected at least one, each once"),
        ("seeds = { count = 4 }", "seeds = [-1]", "seeds[0]: "),
        ("seeds = { count = 4 }", "seed = 4", "seed"),
        ('name = "short"', 'name = "a/b"', "name: "),
        ("[missions]", "[mission]", "mission: unknown key"),
        ("[missions]", "[identify]\n[missions]", 'identify: kind is "missions"'),
        ("limit_s = 8.0", "limits_s = 10.0", "missions.limits_s: unknown key"),
        ("limit_s = 8.0", "limit_s = -1.0", "missions.limit_s: "),
        ("limit_s = 8.0", "limit_s = 0.5", "missions: limit_s: expected more than station_s (1 s)"),
        (GRID, f'{GRID}\n"weather.V_c_m_s" = [0.3]', "grid.weather.V_c_m_s: is there twice"),
        ("[7.5, 8.5]", "[-1e308, 1e308]", "uniform: expected numbers that lie closer together"),
        ('mission = "leg.toml"', 'mission = "gone.toml"', "files.mission: gone.toml: No such file"),
        ('mission = "leg.toml"', 'log = "leg.toml"', "files.log: unknown key; of missions there are run, vessel"),
        ('mission = "leg.toml"', 'mission = "short.toml"', "short.toml: (file): is a campaign file; expected"),
        ('run = "', 'vessel = "', "files.run: missing key"),
        (GRID, "weather.V_c_m_s = 0.1", "grid.weather.V_c_m_s: expected a list of values"),
        (GRID, "weather.V_c_m_s = []", "grid.weather.V_c_m_s: expected at least one value"),
        (GRID, "weather.V_c_m_s = [0.1, 0.1]", "grid.weather.V_c_m_s: a value is there twice"),
        (GRID, 'weather.V_c_m_s = [0.1, "no"]', "grid.weather.V_c_m_s: expected numbers, texts"),
        (GRID, f"weather.V_c_m_s = [0.5, {10**400}]", "grid.weather.V_c_m_s: expected whole numbers of at most"),
        (GRID, "weather.V_c_m_s = [nan]", "grid.weather.V_c_m_s[0]: expected a finite number"),
        (GRID, "weather.V_d_m_s = [0.1]", "grid.weather.V_d_m_s = 0.1: weather.V_d_m_s: unknown key; there are V_"),
        (GRID, 'weather.V_c_m_s = ["calm"]', "grid.weather.V_c_m_s = 'calm': weather.V_c_m_s: "),
        (GRID, "world.mismatch = [2.0]", "grid.world.mismatch = 2.0: world.mismatch: "),
        (GRID, "weather.V_w_m_s = [-4.0]", "weather.V_w_m_s = -4.0: weather.V_w_m_s: expected a number >= 0"),
        (GRID, "weather.V_c_m_s = [100.0]", "weather.V_c_m_s: expected a number <= 10"),
        (GRID, "weather.gust_time_s = [-10.0]", "weather.gust_time_s: expected a number >= 0.1"),
        (GRID, "weather.T_p_s = [0.0]", "weather.T_p_s: expected a number >= 0.2"),
        (GRID, "weather.H_s_m = [-0.1]", "weather.H_s_m: expected a number >= 0"),
        (GRID, "weather.gustiness = [-0.2]", "weather.gustiness: expected a number >= 0"),
        (GRID, "faults.dropout = [5.0]", "faults.dropout: expected a number <= 1"),
        (GRID, "faults.nlos = [-1.0]", "faults.nlos: expected a number >= 0"),
        (GRID, "faults.nlos_m = [-3.0]", "faults.nlos_m: expected a number >= 0"),
        ("[draw]\nworld.north_m = { uniform = [7.5, 8.5] }", "world.north_m = [8.0, 5000.0]",
         "world.north_m, world.east_m: a start at north 5000, east 6 m lies beyond the fence of site"),
        (GRID, "wether.V_c_m_s = [0.1]", "wether.V_c_m_s: keys of missions begin with run, vessel, truth"),
        (GRID, "vessel.inertia.mass_kg = [45.0, -1.0]", "grid.vessel.inertia.mass_kg = -1.0: "),
        (GRID, "vessel.inertia.mass = [45.0]", "inertia.mass: unknown key"),
        (GRID, "vessel.thrusters.bow.gain = [0.5]", "aritra.toml: thrusters.bow: nothing of that name; there are"),
        (GRID, "vessel.inertia = [1.0]", "inertia: is no single value"),
        (GRID, "vessel.name.x = [1.0]", "name"),
        (GRID, 'run.vessel = ["a.toml"]', "run.vessel: files are chosen by files.vessel"),
        (GRID, "run.control.lease_s = [0.05]", "control.lease_s: expected more than control.period_s"),
        (GRID, "missions.limit_s = [10.0, -1.0]", "grid.missions.limit_s = -1.0: missions.limit_s: "),
        (GRID, 'files.run = ["a.toml"]', "files.run: a.toml: No such file"),
        (GRID, "files.mission = [1]", "grid.files.mission: expected a list of file names"),
        ("{ uniform = [7.5, 8.5] }", "7.5", "draw.world.north_m: expected for example { uniform"),
        ("{ uniform = [7.5, 8.5] }", "{ uniform = [8.5, 7.5] }", "draw.world.north_m: uniform: expected the smaller"),
        ("{ uniform = [7.5, 8.5] }", "{ uniform = [7.5] }", "draw.world.north_m: "),
        ("{ uniform = [7.5, 8.5] }", "{ log_uniform = [0.0, 1.0] }", "log_uniform: expected numbers above 0"),
        ("{ uniform = [7.5, 8.5] }", "{ normal = [7.5, 0.0] }", "normal: expected [mean, sigma] with sigma above 0"),
        ("{ uniform = [7.5, 8.5] }", "{ normal = [7.5, 1.0], choice = [1] }", "expected one of uniform, log_uniform"),
        ("{ uniform = [7.5, 8.5] }", "{ choice = [] }", "draw.world.north_m: "),
        ("world.north_m", "missions.limit_s", "draw.missions.limit_s: files and settings of missions can stand"),
        ("world.north_m", "weather.V_c_m_s", "weather.V_c_m_s: stands in more than one of set, grid and draw"),
        ("[draw]", '[set]\nfiles.mission = "leg.toml"\n[draw]', "set.files.mission: files that all cases share stand"),
        ("[draw]", "[set]\nfaults.nlos = [1]\n[draw]", "set.faults.nlos: expected numbers"),
        ("[draw]", "[drawn]", "drawn: unknown key"),
        ("[draw]", "[draw", "not valid TOML"),
    ],
)  # fmt: skip
def test_a_bad_file_is_refused_by_name_and_key(tmp_path, old, new, words):
    path = campaign_file(tmp_path, old=old, new=new)
    with pytest.raises(ConfigError, match=re.escape(words)) as refused:
        read_campaign(path)
    assert str(refused.value).startswith(str(path))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("", "identify: expected either files.log or identify.drive_s"),
        ('[grid]\nfiles.log = ["a.csv"]\n[identify]\ndrive_s = 60.0', "identify: expected either files.log or"),
        ('[grid]\nfiles.log = ["a.csv"]\n[set]\ntruth.inertia.mass_kg = 40.0', "truth.inertia.mass_kg: needs identify"),
        ("[identify]\ndrive_s = 20.0", "identify.drive_s: "),
        ("[identify]\ndrive_s = 60.0\n[set]\nrun.control.latency_s = 0.1", "keys of identify begin with vessel, truth"),
        ('[grid]\nfiles.log = ["gone.csv"]', "files.log: gone.csv: No such file"),
    ],
)  # fmt: skip
def test_bad_files_of_fits(tmp_path, more, words):
    from companion.boat.load_run import EXAMPLES

    (tmp_path / "a.csv").write_text("t_s\n")
    vessel = EXAMPLES / "boats" / "aritra.toml"
    path = tmp_path / "fits.toml"
    head = f'format = 1\nname = "f"\nkind = "identify"\nseeds = [1]\n[files]\nvessel = "{vessel}"\n'
    path.write_text(head + more)
    with pytest.raises(ConfigError, match=re.escape(words)) as refused:
        read_campaign(path)
    assert str(refused.value).startswith(str(path))
