"""deploy/install.sh: which Python it takes, and the environment that was interrupted, broken or is sound."""

import pytest

TOO_OLD = "exit 1"
NO_VENV = 'case "$2" in *ensurepip*) exit 1 ;; *base_prefix*) echo /usr ;; esac'
IN_A_HOME = 'case "$2" in *base_prefix*) echo /home/somebody/.local ;; esac'
PYTHONS = ["python3", "python3.11", "python3.12", "python3.13"]


def only(bench, **stubs):
    """The Pythons that the script looks for are too old, but for `stubs`."""
    for name in PYTHONS:
        bench.stub(name, stubs.get(name.replace(".", "_"), TOO_OLD))


def made(bench):
    """What was asked for: environments, packages, and the program."""
    asked = bench.asked()
    venvs = asked.count(f"-m venv --clear {bench.root}/opt/aritra")
    packages = sum("--require-hashes" in line for line in asked)
    return venvs, packages, len(asked) - venvs - packages


def test_another_python_that_is_named_gets_a_new_environment(bench):
    bench.installed()
    bench.python = bench.noting("another-python", base="another")
    bench.installed()
    assert made(bench) == (2, 2, 2)
    bench.installed()
    assert made(bench) == (2, 2, 3), "once: then it is the one that is there"


def test_an_interrupted_installation_is_taken_up_again(bench):
    failing = bench.fail()
    assert bench.run().returncode == 1, "pip failed"
    assert not (bench.root / "etc/systemd/system/aritra.service").exists(), "the unit comes last"
    failing.unlink()
    bench.installed()
    assert made(bench) == (1, 2, 1)


def test_an_environment_without_pip_is_made_anew_with_all_its_packages(bench):
    """As one is that was killed half-way, or whose Python became another by an upgrade of the system."""
    bench.installed()
    (bench.root / "opt/aritra/no-pip").touch()
    told = bench.installed("--dry-run")
    assert "-m venv" in told and "--require-hashes" in told
    bench.installed()
    assert made(bench) == (2, 2, 2)


def test_an_environment_that_was_not_made_to_its_end_is_made_anew(bench):
    bench.installed()
    (bench.root / "opt/aritra/requirements.sha256").unlink()
    bench.installed()
    assert made(bench) == (2, 2, 2)


def test_packages_that_were_interrupted_are_not_taken_for_those_before(bench):
    bench.installed()
    stamp = bench.root / "opt/aritra/requirements.sha256"
    stamp.write_text("of an older requirements.lock, to which a person may go back\n")
    bench.fail()
    assert bench.run().returncode == 1
    assert stamp.read_text() == ""


def test_a_sound_environment_needs_no_python_of_the_system(bench):
    bench.installed()
    only(bench)
    done = bench.run(python=False)
    assert done.returncode == 0, done.stderr
    assert made(bench) == (1, 1, 2)


def test_one_without_venv_is_passed_over(bench):
    only(bench, python3=NO_VENV)
    bench.noting("python3.12")
    done = bench.run(python=False)
    assert done.returncode == 0, done.stderr
    assert made(bench) == (1, 1, 1)


def test_one_in_a_home_is_passed_over(bench):
    bench.systemctl("inactive")
    only(bench, python3=IN_A_HOME)
    bench.noting("python3.12")
    done = bench.run("--dry-run", root=False, python=False)
    assert done.returncode == 0 and "+ python3.12 -m venv --clear /opt/aritra" in done.stdout, done.stderr


def test_where_none_serves_it_says_why_the_first_did_not(bench):
    bench.systemctl("inactive")
    only(bench, python3=NO_VENV, python3_13=IN_A_HOME)
    done = bench.run("--dry-run", root=False, python=False)
    assert done.returncode == 2 and "python3 has no venv: install its venv package" in done.stderr


def test_a_python_with_a_space_in_its_path_is_one_word(bench):
    bench.python = bench.noting("a python")
    bench.installed()
    assert made(bench) == (1, 1, 1)


@pytest.mark.parametrize("home", ["/home/somebody/.local", "/root/.pyenv"])
def test_a_python_in_a_home_is_refused_where_it_would_serve(bench, home):
    """The unit has ProtectHome=yes: it would install, and never start."""
    bench.systemctl("inactive")
    bench.python = bench.stub("python-home", f'case "$2" in *base_prefix*) echo {home};; esac')
    done = bench.run("--dry-run", root=False)
    assert done.returncode == 2 and f"lies in {home}, which the service may not read" in done.stderr


def test_an_old_python_is_refused(bench):
    bench.python = bench.stub("python-old", TOO_OLD)
    done = bench.run()
    assert done.returncode == 2 and "is none" in done.stderr and not bench.root.exists()


def test_where_python_is_too_old_it_says_what_to_do(bench):
    only(bench)
    done = bench.run(python=False)
    assert done.returncode == 2 and not bench.root.exists()
    assert "apt install python3.11 python3.11-venv" in done.stderr and "uv python install" in done.stderr
