"""deploy/install.sh into a folder, with a Python that only notes what it was asked for, and without root."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from companion.boat.load_run import load_setup

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "deploy" / "install.sh"


def test_a_dry_run_changes_nothing(bench):
    told = bench.installed("--dry-run")
    assert not bench.root.exists() and bench.asked() == []
    assert "-m venv" in told and "aritra.service" in told and "nothing was changed" in told


def test_a_dry_run_that_may_not_look_into_the_configuration_says_so(bench):
    """The folder has mode 750: a person without the group aritra sees nothing of it."""
    bench.installed()
    config = bench.root / "etc/aritra"
    (config / "aritra.toml").write_text("# mine\n")
    within = ()
    if os.getuid() == 0:  # root looks everywhere, unless it lets go of that
        within = (shutil.which("setpriv") or pytest.skip("no setpriv"), "--bounding-set=-dac_override,-dac_read_search")
    config.chmod(0)
    done = bench.run("--dry-run", within=within)
    config.chmod(0o750)
    assert done.returncode == 0, done.stderr
    assert f"cannot look into {config}" in done.stdout and "sudo" in done.stdout and "aritra.toml" not in done.stdout


def test_from_wherever_cd_may_go_it_finds_its_checkout(bench):
    done = bench.run(script=SCRIPT.relative_to(ROOT), CDPATH=str(ROOT))
    assert done.returncode == 0, done.stderr


def test_it_installs_everything_in_its_place(bench):
    bench.installed()
    for target, source in [
        ("etc/systemd/system/aritra.service", "deploy/aritra.service"),
        ("etc/udev/rules.d/70-aritra.rules", "deploy/udev/70-aritra.rules"),
        ("etc/aritra/aritra.toml", "deploy/on-board.toml"),
        ("etc/aritra/zenoh/boat.json5", "deploy/zenoh/boat.json5"),
        ("etc/aritra/zenoh/router.json5", "deploy/zenoh/router.json5"),
        ("etc/aritra/zenoh/shore.json5", "deploy/zenoh/shore.json5"),
        ("opt/aritra/share/doc/aritra/service.md", "docs/service.md"),
        ("opt/aritra/share/aritra/zenoh/make-certificates", "deploy/zenoh/make-certificates"),
        ("opt/aritra/share/aritra/zenoh/router.py", "deploy/zenoh/router.py"),
    ]:
        assert (bench.root / target).read_bytes() == (ROOT / source).read_bytes()
    venv, lock, program = bench.asked()
    assert venv == f"-m venv --clear {bench.root}/opt/aritra"
    assert "--require-hashes" in lock and lock.endswith(f"-r {ROOT}/requirements.lock")
    assert "--no-deps" in program and program.endswith(f" {ROOT}")
    tree = bench.tree()
    assert {mode for path, (mode, content) in tree.items() if path.startswith("etc/aritra") and content} == {0o640}
    assert {mode for path, (mode, content) in tree.items() if path.startswith("etc/aritra") and not content} == {0o750}
    assert {tree[f"opt/aritra/share/aritra/zenoh/{name}"][0] for name in ("make-certificates", "router.py")} == {0o755}
    assert tree["var/lib/aritra"] == (0o750, None), "for runs by hand, before the unit ran"
    assert not [path for path in tree if path.endswith(".key")]
    assert all(mode & 0o005 for path, (mode, _) in tree.items() if path.startswith(("opt", "etc/systemd", "etc/udev")))


def test_what_it_installs_is_a_configuration_that_runs(bench):
    bench.installed()
    setup = load_setup(bench.root / "etc/aritra/aritra.toml")
    assert setup.pilot.vessel.name == "aritra" and setup.run.log.folder == "/var/lib/aritra/logs"


def test_from_a_stick_without_modes_of_files_it_installs_the_same(bench, tmp_path):
    """FAT has no modes: all files may be run."""
    bench.installed()
    expected = {path for path in bench.tree() if path.startswith("etc/aritra")}
    stick = tmp_path / "stick"
    shutil.copytree(ROOT / "deploy", stick / "deploy")
    shutil.copytree(ROOT / "docs", stick / "docs", ignore=shutil.ignore_patterns("figures", "site"))
    shutil.copy(ROOT / "requirements.lock", stick)
    for file in stick.rglob("*"):
        file.chmod(0o755)
    bench.root = tmp_path / "second"
    bench.installed(script=stick / "deploy/install.sh")
    assert {path for path in bench.tree() if path.startswith("etc/aritra")} == expected


def test_a_second_run_changes_nothing_but_the_program(bench):
    bench.installed()
    before, asked = bench.tree(), len(bench.asked())
    told = bench.installed()
    assert bench.tree() == before
    assert "install -D" not in told and "venv" not in told
    (program,) = bench.asked()[asked:]
    assert program.endswith(f" {ROOT}")


def test_what_a_person_edited_stays(bench):
    bench.installed()
    mine, site = bench.root / "etc/aritra/aritra.toml", bench.root / "etc/aritra/sites/basin.toml"
    mine.write_text("# mine\n")
    site.unlink()
    (bench.root / "etc/systemd/system/aritra.service").write_text("old\n")
    told = bench.installed()
    assert mine.read_text() == "# mine\n" and f"kept: {mine}" in told
    assert site.exists(), "what is missing comes back"
    assert (bench.root / "etc/systemd/system/aritra.service").read_text() == (
        SCRIPT.parent / "aritra.service"
    ).read_text()


def test_configuration_is_there_whole_or_not_at_all(bench):
    """A disk that is full, or a power cut: install leaves half of a file, and the next run mends it."""
    copy = shutil.which("install") + ' "$@"; for target; do :; done'
    half = bench.stub("install", f'{copy}; case "$target" in */etc/*) echo half > "$target"; exit 1;; esac')
    mine = bench.root / "etc/aritra/aritra.toml"
    assert bench.run().returncode == 1 and not mine.exists()
    half.unlink()
    bench.installed()
    assert mine.read_bytes() == (SCRIPT.parent / "on-board.toml").read_bytes()
    assert not [path for path in bench.tree() if path.endswith(".new")]


def test_an_empty_file_of_configuration_is_as_none(bench):
    """As a power cut left it that came before the disk had its content."""
    bench.installed()
    mine, site = bench.root / "etc/aritra/aritra.toml", bench.root / "etc/aritra/sites/basin.toml"
    mine.write_text("# mine\n")
    site.write_text("")
    bench.installed()
    assert site.read_bytes() == (SCRIPT.parent / "sites/basin.toml").read_bytes() and mine.read_text() == "# mine\n"


def test_keys_stay_with_their_owner_and_what_others_could_read_is_taken_from_them(bench):
    bench.installed()
    config = bench.root / "etc/aritra"
    keys = [config / "boat.key", config / "zenoh/boat.key"]
    for key, mode in zip(keys, (0o600, 0o644), strict=True):
        key.write_text("a passphrase that nobody guesses\n")
        key.chmod(mode)
    certificate, pages = config / "zenoh/ca.pem", config / "zenoh/notes"
    certificate.write_text("")
    certificate.chmod(0o600)  # as root wrote it, with a careful umask
    pages.mkdir(mode=0o777)
    pages.chmod(0o777)
    bench.installed()
    assert [key.stat().st_mode & 0o777 for key in keys] == [0o600, 0o600]
    assert pages.stat().st_mode & 0o777 == 0o750
    if os.getuid() == 0:
        assert certificate.stat().st_mode & 0o777 == 0o640, "the service may read what root put there"
    before = bench.tree()
    bench.installed("--uninstall")
    left = bench.tree()
    assert all(left[f"etc/aritra/{name}"] == before[f"etc/aritra/{name}"] for name in ("boat.key", "zenoh/boat.json5"))
    assert not (bench.root / "opt/aritra").exists()


def test_on_a_system_keys_are_the_service_s(bench):
    bench.systemctl("inactive")
    bench.stub("getent", "exit 0")
    plan = bench.run("--dry-run", root=False).stdout
    assert "+ find /etc/aritra -type f -name *.key -exec chown aritra {} +" in plan
    assert "+ find /etc/aritra -type f -name *.key -exec chmod 600 {} +" in plan
    assert "zenoh/boat.json5 /etc/aritra/zenoh/boat.json5" in plan


def test_uninstall_keeps_configuration_and_logs(bench):
    bench.installed()
    log = bench.root / "var/lib/aritra/logs/aritra-20260101-000000.mcap"
    log.parent.mkdir(parents=True)
    log.touch()
    before = bench.tree()
    bench.installed("--uninstall", "--dry-run")
    assert bench.tree() == before
    told = bench.installed("--uninstall")
    files = {path for path, (_, content) in before.items() if content is not None}
    left = {path for path, (_, content) in bench.tree().items() if content is not None}
    assert left == {path for path in files if path.startswith(("etc/aritra/", "var/"))}
    assert "kept:" in told and log.exists() and not (bench.root / "opt/aritra").exists()
    done = bench.run("--uninstall")
    assert done.returncode == 2 and "nothing to remove" in done.stderr


def test_changes_to_the_unit_and_the_cache_are_told_where_they_are_there(bench):
    bench.installed()
    changes, cache = bench.root / "etc/systemd/system/aritra.service.d", bench.root / "var/cache/aritra"
    assert not any(str(path) in bench.installed() for path in (changes, cache))
    for path in (changes, cache):
        path.mkdir(parents=True)
    assert f"kept: {changes}, which changes the unit" in bench.installed()
    kept, words = bench.installed("--uninstall").splitlines()[-2:]
    assert kept.startswith("kept:") and all(f"{path}, " in kept and str(path) in words for path in (changes, cache))


def test_uninstall_removes_no_folder_that_is_not_an_environment(bench):
    precious = bench.root / "opt/aritra/precious"
    precious.parent.mkdir(parents=True)
    precious.touch()
    bench.installed("--uninstall")
    assert precious.exists()


def test_on_a_system_it_makes_user_and_reloads_but_starts_nothing(bench):
    bench.systemctl("inactive")
    bench.stub("getent", "exit 2")
    done = bench.run("--dry-run", root=False)
    assert done.returncode == 0, done.stderr
    plan = [line.removeprefix("+ ") for line in done.stdout.splitlines() if line.startswith("+ ")]
    assert any(line.startswith("useradd --system --gid aritra") for line in plan)
    assert plan.index("usermod -aG dialout aritra") > [line.split()[0] for line in plan].index("useradd")
    assert "chown aritra:aritra /var/lib/aritra" in plan and "chown root:aritra /etc/aritra" in plan
    assert "systemctl daemon-reload" in plan and "udevadm control --reload" in plan
    assert not any(line.startswith(("systemctl start", "systemctl enable", "systemctl restart")) for line in plan)


@pytest.mark.parametrize(("groups", "joins"), [("aritra", True), ("aritra dialout", False)])
def test_a_user_that_is_there_may_open_serial_devices_too(bench, groups, joins):
    bench.systemctl("inactive")
    bench.stub("getent", "exit 0")
    bench.stub("id", f"echo {groups}")
    plan = bench.run("--dry-run", root=False).stdout
    assert ("+ usermod -aG dialout aritra" in plan) == joins and "+ useradd" not in plan


@pytest.mark.parametrize("state", ["active", "activating", "deactivating"])
def test_a_boat_that_runs_is_left_alone(bench, state):
    bench.systemctl(state)
    done = bench.run("--dry-run", root=False)
    assert done.returncode == 2 and "aritra.service is running" in done.stderr and bench.asked() == []


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--fast"], "unknown option --fast"),
        (["--root"], "--root needs a folder"),
        (["--root", "/nowhere", "--python", "no-such-python"], "no Python 3.11 or newer found: no-such-python is none"),
    ],
)
def test_bad_input_is_named(bench, words, told):
    done = bench.run(*words, root=False, python=False)
    assert done.returncode == 2 and told in done.stderr


def test_the_script_is_sound_shell():
    assert subprocess.run(["bash", "-n", str(SCRIPT)], check=False).returncode == 0
    shellcheck = shutil.which("shellcheck")
    if shellcheck is None:
        pytest.skip("shellcheck is not on this machine; bash accepts the script")
    done = subprocess.run([shellcheck, str(SCRIPT)], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout
