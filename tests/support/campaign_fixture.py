"""A campaign of short missions, and what runs works without any boat, for tests."""

from pathlib import Path

from companion.boat.load_run import EXAMPLES
from sim.campaign.inputs import read_campaign
from sim.campaign.runners.job import CaseOutcome

LEG = """name = "leg"
[[waypoints]]
north_m = 9.0
east_m = 9.0
speed_m_s = 0.5
[[waypoints]]
north_m = 13.0
east_m = 9.0
speed_m_s = 0.5
"""
SHORT = f"""format = 1
name = "short"
kind = "missions"
seeds = {{ count = 4 }}
[files]
run = "{EXAMPLES / "aritra.toml"}"
mission = "leg.toml"
[missions]
limit_s = 8.0
station_s = 1.0
[grid]
weather.V_c_m_s = [0.0, 0.1]
[draw]
world.north_m = {{ uniform = [7.5, 8.5] }}
"""
PROGRAM = {"aritra": "for tests"}


def campaign_file(folder: Path, text: str = SHORT, old: str = "", new: str = "") -> Path:
    """The text in a folder, with `new` in the place of `old`."""
    (folder / "leg.toml").write_text(LEG)
    assert old in text
    text = text.replace(old, new) if old else text
    path = folder / "short.toml"
    path.write_text(text)
    return path


def cases_of(path: Path):
    return read_campaign(path)[1]


def figures(work) -> dict:
    """Some that depend on all of the case."""
    return {"finished": True, "waypoints_missed": 0, "nees": work.seed + work.values["world.north_m"], "mode": "auto"}


def pretend(fails=lambda work: False, stop_after=10**9):
    """A runner that computes nothing; `stop_after` outcomes it is interrupted."""
    ran = []

    def run(works):
        for work in works:
            if len(ran) == stop_after:
                raise KeyboardInterrupt
            ran.append(work.id)
            if fails(work):
                yield CaseOutcome(id=work.id, error="ValueError: for the test", trace="Traceback", program=PROGRAM)
            else:
                yield CaseOutcome(id=work.id, figures=figures(work), program=PROGRAM, seconds=1.0, worker="here:1")

    run.ran = ran
    return run
