"""Configuration: what is wrong is named with file and key; nothing unknown gets through."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.configuration.file_kinds import kind_of_file
from companion.core.configuration.run_file import load_run
from companion.core.configuration.site_file import load_site
from companion.core.configuration.spelling import did_you_mean
from companion.core.configuration.tables import ConfigError, digest
from companion.core.excitation.file import load_excitation
from companion.core.guidance.missions.mission import MissionErrors, parse
from companion.core.model.load_vessel import load_vessel
from tests.support.vessel_fixtures import BOATS, boat

TEXT = (BOATS / "aritra.toml").read_text()
SITE = (BOATS.parent / "sites" / "basin.toml").read_text()
TERM = '\n[terms.current]\nV_c_m_s = 0.1\nbeta_c_deg = 20.0\nsource = "test"\n'


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("mass_kg = 45.0", "mass_kgs = 45.0", "inertia.mass_kgs: unknown key; did you mean mass_kg?"),
        ("mass_kg = 45.0", "mass_kg = -45.0", "inertia.mass_kg: expected 0.1 to 100000, found -45"),
        ("mass_kg = 45.0\n", "", "inertia.mass_kg: missing key"),
        ("X_u_N_s_m = -3.5", "X_u_N_s_m = 3.5", "damping.X_u_N_s_m: expected -1e+06 to 0, found 3.5"),
        ("Y_r_N_s = -1.0", "Y_r_N_s = -90.0", "damping: the linear part feeds energy"),
        ("Y_rdot_kg_m = -0.8", "Y_rdot_kg_m = -80.0", "inertia: M_RB + M_A is not positive definite"),
        ("channel = 10", "channel = 9", "thrusters[1].channel: channel 9 is there twice"),
        ('name = "front_starboard"', 'name = "front_port"', "thrusters[1].name: 'front_port' is there twice"),
        ('force_map = "t200"', 'force_map = "t100"', "thrusters[0].force_map: no table force_maps.t100"),
        ("lag_s = 0.1", "lag_s = 'fast'", "propulsion.lag_s: expected a number, found text"),
        ("format = 1", "format = 2", "format: "),
        ("[hull]", "[hull", "not valid TOML"),
        ("format = 1", "format = 1" + TERM.replace("current", "tide"), "terms.tide: no such term"),
        ("format = 1", "format = 1" + TERM.replace("0.1", "9.0"), "terms.current.V_c_m_s: expected 0.0 to 2.0"),
        ("format = 1", "format = 1" + TERM.replace("V_c_m_s", "speed"), "terms.current.speed: unknown key"),
    ],
)  # fmt: skip
def test_errors_name_file_and_key(old, new, says):
    changed = TEXT.replace(old, new, 1)
    if "[terms" in new:
        changed = TEXT + new.removeprefix("format = 1")
    assert changed != TEXT
    with pytest.raises(ConfigError) as caught:
        load_vessel(changed, name="boats/aritra.toml")
    assert str(caught.value).startswith("boats/aritra.toml: ")
    assert says in str(caught.value)


@pytest.mark.parametrize("load", [load_vessel, load_site, load_run, load_excitation])
def test_a_file_of_another_kind_is_named(load):
    mission = (BOATS.parent / "missions" / "square.toml").read_text()
    with pytest.raises(ConfigError, match=r"^a\.toml: is a mission; expected an? .*, for example deploy/"):
        load(mission, name="a.toml")


def test_a_vessel_file_is_no_mission():
    with pytest.raises(MissionErrors, match="is a vessel file; expected a mission"):
        parse(TEXT, "toml")


@given(st.binary(max_size=200))
def test_any_bytes_have_a_kind_or_none(data):
    assert kind_of_file(data) is None or kind_of_file(data).startswith(("a ", "an ", "binary", "text"))


def test_what_was_meant():
    assert did_you_mean("--miss", ["--mission", "--mismatch"]) == "; did you mean --mission?"
    assert did_you_mean("lgo", ["log", "run"]) == "; did you mean log?"
    assert did_you_mean("xyzzy", ["log", "run"]) == did_you_mean("", ["log"]) == did_you_mean("log", []) == ""


def numeric_tables(node, path=""):
    """Every table of a TOML document that holds a number, with its path."""
    if isinstance(node, dict):
        if any(isinstance(v, (int, float)) and not isinstance(v, bool) for v in node.values()):
            yield path, node
        for key, value in node.items():
            yield from numeric_tables(value, f"{path}.{key}")
    elif isinstance(node, list):
        for i, value in enumerate(node):
            yield from numeric_tables(value, f"{path}[{i}]")


@pytest.mark.parametrize("name", ["aritra", "twin", "cse1"])
def test_every_table_of_numbers_says_where_they_come_from(name):
    """The curve tables of a force map stand under their map's source."""
    data = tomllib.loads((BOATS / f"{name}.toml").read_text())
    for path, table in numeric_tables(data):
        if path and not path.endswith((".ahead", ".astern")):
            assert str(table.get("source", "")).strip(), f"{name}{path} has no source"


def test_empty_source_is_refused():
    with pytest.raises(ConfigError, match=r"hull: .*needs a source"):
        load_vessel(TEXT.replace('source = "length', 'source = ""  # "length', 1), name="x.toml")


def test_other_vessels_fit_the_same_format():
    assert len(boat("twin").thrusters) == 2
    assert len(boat("cse1").thrusters) == 5
    assert boat("cse1").force_maps["bow"].ahead_N == 1.0


def test_vessel_files_are_frozen():
    with pytest.raises(AttributeError):
        boat("aritra").name = "other"


@given(st.text(max_size=200))
def test_any_text_is_a_vessel_or_a_named_error(text):
    with pytest.raises(ConfigError, match=r"any\.toml: "):
        load_vessel(text, name="any.toml")


def test_site_refuses_an_anchor_twice():
    assert len(load_site(SITE, name="basin.toml").anchors) == 4
    with pytest.raises(ConfigError, match=r"anchors\[1\].id: anchor '1151' is there twice"):
        load_site(SITE.replace("0CA8", "1151"), name="basin.toml")


def test_digest_names_the_text():
    assert digest("a") != digest("b") and len(digest("a")) == 12


@pytest.mark.parametrize("number", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(
    ("key", "path"),
    [
        ("x_g_m = 0.02", "inertia.x_g_m"),
        ("mass_kg = 45.0", "inertia.mass_kg"),
        ("azimuth_deg = 45.0", "thrusters[0].azimuth_deg"),
    ],
)
def test_a_number_that_is_none_is_refused(key, path, number):
    changed = TEXT.replace(key, f"{key.split(' = ')[0]} = {number}", 1)
    with pytest.raises(ConfigError) as caught:
        load_vessel(changed, name="x.toml")
    assert str(caught.value) == f"x.toml: {path}: expected a finite number"


def test_a_trim_beyond_the_dead_band_is_refused():
    """The autopilot's neutral is 1500 us: with such a trim it would push."""
    with pytest.raises(ConfigError, match=r"thrusters\[0\].trim_us: expected less than the dead band of 24 us"):
        load_vessel(TEXT.replace("channel = 9\n", "channel = 9\ntrim_us = 24\n", 1), name="x.toml")
    assert load_vessel(TEXT.replace("channel = 9\n", "channel = 9\ntrim_us = 23\n", 1), name="x.toml")


def test_inside_the_fence():
    site = load_site(SITE, name="basin.toml")
    assert site.inside(15.0, 15.0) and site.inside(0.6, 29.4)
    assert not site.inside(15.0, 29.6) and not site.inside(-1.0, 15.0) and not site.inside(30.0, 30.0)
