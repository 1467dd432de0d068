"""Wrong uses of the commands, as people make them, and what the answer must name: file, key or option, what to do.

`make_files` writes what the lines use into a folder: `{d}`; `{boat}` is the example vessel file in it.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from companion.boat.load_run import EXAMPLES
from tests.companion.logs.page.page_logs import page_log

Replacement = tuple[str, str, str, str]
"""(new file, file of deploy/, text in it, what stands there instead)."""

CHANGED: tuple[Replacement, ...] = (
    ("typo.toml", "aritra.toml", "mission =", "misson ="),
    ("lost.toml", "aritra.toml", "boats/aritra.toml", "boats/mine.toml"),
    ("url.toml", "aritra.toml", "udpin:127.0.0.1:14551", "udp//127.0.0.1"),
    ("baud.toml", "aritra.toml", "serial:/tmp/aritra-uwb:115200", "serial:/tmp/aritra-uwb:fast"),
    ("period.toml", "aritra.toml", "period_s = 0.1", "period_s = 10"),
    ("string.toml", "aritra.toml", "low_V = 14.0", 'low_V = "14"'),
    ("quota.toml", "aritra.toml", "[battery]", "[log]\nquota_MB = -1\n[battery]"),
    ("heavy.toml", "boats/aritra.toml", "mass_kg = 45.0", "mass_kg = -45.0"),
    ("unit.toml", "boats/aritra.toml", "mass_kg = 45.0", "mass_g = 45000.0"),
    ("undamped.toml", "boats/aritra.toml", "X_u_N_s_m = -3.5", "X_u_N_s_m = 3.5"),
    ("twice.toml", "boats/aritra.toml", 'name = "front_star', 'name = "front_port"\n# name = "front_star'),
    ("channel.toml", "boats/aritra.toml", "channel = 10", "channel = 9"),
    ("nan.toml", "boats/aritra.toml", "length_m = 1.47", "length_m = nan"),
    ("map.toml", "boats/aritra.toml", "force_maps.t200]", "force_maps.t500]"),
    ("comma.toml", "boats/aritra.toml", "draft_m = 0.10", "draft_m = 0,10"),
    ("fence.toml", "sites/basin.toml", "[29.5, 0.5], [29.5, 29.5], ", ""),
    ("crossed.toml", "sites/basin.toml", "[29.5, 0.5], [29.5, 29.5]", "[29.5, 29.5], [29.5, 0.5]"),
    ("anchor.toml", "sites/basin.toml", 'id = "0CA8"', 'id = "1151"'),
    ("latitude.toml", "sites/basin.toml", "lat_deg = 12.9915", "lat_deg = 129.9"),
    ("fast.toml", "missions/square.toml", "speed_m_s = 0.5", "speed_m_s = 50"),
    ("outside.toml", "missions/square.toml", "north_m = 21.0", "north_m = 210.0"),
    ("one.toml", "missions/square.toml", "[[waypoints]]", "[[waypoint]]"),
    ("deploy/campaigns/seeds.toml", "campaigns/weather.toml", "count = 20", "count = 0"),
    ("deploy/campaigns/grid.toml", "campaigns/weather.toml", "weather.V_c_m_s", "weather.current"),
)

WRONG_USES = (
    ("demoo", "'demoo'|did you mean demo?"),
    ("simulate", "'simulate'|choose from demo, check"),
    ("", "COMMAND|--help"),
    ("demo --sed 3", "--sed|did you mean --seed?"),
    ("demo --seed three", "--seed|'three'|a whole number"),
    ("demo --mismatch 10", "--mismatch|'10'|0 to 0.5"),
    ("demo --dropout 20", "--dropout|0 to 1"),
    ("demo --nlos -1", "--nlos|0 to 1"),
    ("demo --wind -3 0", "--wind|[m/s], 0 to 60"),
    ("demo --wind 3", "--wind|expected 2 arguments"),
    ("demo --gusts 5", "--gusts|0 to 1"),
    ("demo --start 100 100 0", "--start|beyond the fence of site basin"),
    ("demo --boats 0", "--boats|1 to 100"),
    ("demo --boats a,a", "--boats|'a' is there twice"),
    ("demo --config {d}/typo.toml", "typo.toml|misson|did you mean mission?"),
    ("demo --config {d}/lost.toml", "lost.toml: vessel|boats/mine.toml|No such file"),
    ("demo --config {d}/nowhere.toml", "--config|nowhere.toml|No such file"),
    ("demo --config {boat}", "--config|is a vessel file|expected a run file, for example deploy/aritra.toml"),
    ("demo --out {d}/picture.png", "picture.png|is a file; name a folder"),
    ("run --config {d}/url.toml", "url.toml|mavlink.url|udpin:HOST:PORT"),
    ("run --config {d}/baud.toml", "baud.toml|uwb.url|'fast'|such as 115200"),
    ("run --config {d}/period.toml", "period.toml|control.period_s|0.05 to 0.4"),
    ("run --config {d}/string.toml", "string.toml|battery.low_V|expected a number"),
    ("run --config {d}/quota.toml", "quota.toml|log.quota_MB|expected 0.001 to"),
    ("run --mission {d}/outside.toml", "outside.toml|waypoint 2|beyond the fence: move it"),
    ("run --mission {d}/fast.toml", "fast.toml|waypoints[0]: speed|at most 20"),
    ("run --mission {d}/one.toml", "one.toml|waypoint|did you mean waypoints?"),
    ("run --mission {boat}", "--mission|is a vessel file|for example deploy/missions/square.toml"),
    ("run --mavlink 127.0.0.1:14550", "--mavlink|udpout:HOST:PORT"),
    ("run --uwb {d}/picture.png", "--uwb|did you mean 'serial:"),
    ("run --device dvl", "--device|NAME=URL, for example"),
    ("run --device sonar=serial:/dev/ttyUSB0:115200", "--device|sonar|the boat has none"),
    ("check --listen-s -1", "--listen-s|0.01 to 3600"),
    ("provision", "--wiring --logs|required"),
    ("provision --wiring gates", "--wiring|'gates'|choose from gate, scaled, omni"),
    ("teleop --gamepad /dev/input/js9", "needs a terminal"),
    ("shore --host 0.0.0.0 --token 1", "--token|8 to 100 letters"),
    ("shore --port 99999", "--port|0 to 65535"),
    ("shore --command-key {d}/nowhere.key", "--command-key|nowhere.key|No such file"),
    ("shore --connect 192.168.1.20", "--connect|such as tcp/192.168.1.20:7447"),
    ("shore --logs {d}/picture.png", "--logs|picture.png|no such folder"),
    ("sim --param ATC_STR_RAT_P", "--param|expected NAME,VALUE"),
    ("sim --udp-to localhost", "--udp-to|HOST:PORT"),
    ("vessel new --size 1.2 --out {d}/new.toml", "--size|expected 2 arguments"),
    ("vessel new --size 1200 930 --mass 17 --layout x --out {d}/new.toml", "--size|'1200'|[m], 0.1 to 30"),
    (
        "vessel new --size 1.2 0.9 --mass 17 --layout twin --out {d}/new.toml",
        "--layout|'twin'|choose from differential",
    ),
    ("log info {d}/picture.png", "LOG|picture.png|is a picture|expected a log"),
    ("log info {d}/nowhere.mcap", "LOG|nowhere.mcap|No such file"),
    ("log plot {d}/cut.mcap --truth {d}/boat.mcap --out {d}/new.png", "boat.mcap|expected the simulator's own log"),
    ("log plot {d}/boat.mcap --out {d}/picture.png", "picture.png|exists already: choose another name"),
    ("log export {d}/boat.mcap --csv --parquet --out {d}/new", "--parquet|not allowed with argument --csv"),
    (
        "log export {d}/boat.mcap --geojson --site {d}/latitude.toml --out {d}/new.geojson",
        "latitude.toml|lat_deg|-90 to 90",
    ),
    ("identify {d}/boat.mcap --out {d}/new", "required: --vessel"),
    ("identify {d}/boat.mcap --vessel {d}/heavy.toml --out {d}/new", "heavy.toml|inertia.mass_kg|0.1 to 100000"),
    ("identify {d}/boat.mcap --vessel {d}/unit.toml --out {d}/new", "unit.toml|inertia.mass_g|did you mean mass_kg?"),
    (
        "identify {d}/boat.mcap --vessel {d}/undamped.toml --out {d}/new",
        "undamped.toml|damping.X_u_N_s_m|to 0, found 3.5",
    ),
    ("identify {d}/boat.mcap --vessel {d}/twice.toml --out {d}/new", "twice.toml|thrusters[1].name|is there twice"),
    (
        "identify {d}/boat.mcap --vessel {d}/channel.toml --out {d}/new",
        "channel.toml|thrusters[1].channel|channel 9 is there twice",
    ),
    ("identify {d}/boat.mcap --vessel {d}/nan.toml --out {d}/new", "nan.toml|hull.length_m|finite number"),
    ("identify {d}/boat.mcap --vessel {d}/map.toml --out {d}/new", "map.toml|force_maps|missing key"),
    ("identify {d}/boat.mcap --vessel {d}/comma.toml --out {d}/new", "comma.toml|line 10, column"),
    ("identify {d}/short.csv --vessel {boat} --out {d}/new", "short.csv|line 1|r_rad_s|missing"),
    ("diagnose {d}/boat.mcap --vessel {boat} --without wind_force --out {d}/new", "boat.mcap|50 s are the least"),
    ("diagnose {d}/boat.mcap {d}/boat.mcap --vessel {boat} --out {d}/new", "boat.mcap|name each log once"),
    ("excite design --minutes 0 --out {d}/new.toml", "--minutes|0.25 to 120"),
    ("campaign {d}/deploy/campaigns/seeds.toml", "seeds.toml|seeds.count|expected 1 to"),
    ("campaign {d}/deploy/campaigns/grid.toml", "grid.toml|weather.current|there are V_c_m_s"),
    ("commission --vessel {boat} --site {d}/fence.toml --out {d}/new", "fence.toml|fence|at least 3"),
    (
        "commission --vessel {boat} --site {d}/crossed.toml --out {d}/new",
        "crossed.toml|corner 0|in order along the fence",
    ),
    ("commission --vessel {boat} --site {d}/anchor.toml --out {d}/new", "anchor.toml|anchors[1].id|is there twice"),
    ("watch {d}/boat.mcap --vessel {boat} --history {d}/picture.png", "--history|is a file; name a folder"),
    ("bench --only nonsense", "--only nonsense|there are solvers"),
    ("completion tcsh", "'tcsh'|choose from bash, zsh, fish"),
)
"""(line, what the answer must hold, parted by |: what is wrong, where, and what would be right)."""


def make_files(folder: Path) -> None:
    """The example files, each wrong file beside them, a log, a damaged one, and what is no log."""
    shutil.copytree(EXAMPLES, folder / "deploy", ignore=shutil.ignore_patterns("__pycache__", "*.py"))
    for name in ("boats", "sites", "missions"):
        (folder / name).symlink_to(folder / "deploy" / name)
    for name, source, text, instead in CHANGED:
        before = (folder / "deploy" / source).read_text()
        if text not in before:
            raise LookupError(f"{source} has no {text!r}")
        (folder / name).write_text(before.replace(text, instead))
    log = page_log(folder)
    (folder / "cut.mcap").write_bytes(log.read_bytes()[:-60_000])
    (folder / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (folder / "short.csv").write_text("t_s,psi_rad\n0,1\n")
