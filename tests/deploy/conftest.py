"""A bench for deploy/install.sh: a folder to install into, and a Python that only notes what it was asked for."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "deploy" / "install.sh"
PYTHON = """#!/bin/sh
echo "$@" >> "{notes}"
case "$1 $2" in
  "-c import sys; print(sys.base_prefix)") echo /usr ;;
  "-c import sys"*) exec {python} "$@" ;;
  "-m venv") rm -rf "$4"; mkdir -p "$4/bin"; cp "$0" "$4/bin/python"; touch "$4/pyvenv.cfg" ;;
  "-m pip")
    [ ! -e "$(dirname "$0")/../no-pip" ] || {{ echo "No module named pip" >&2; exit 1; }}
    [ "$3" = --version ] || [ ! -e "{notes}.fail" ] || exit 1 ;;
esac
"""
FORBIDDEN = ["chown", "chgrp", "groupadd", "useradd", "usermod", "udevadm"]


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


class Bench:
    """`root`: where it installs. `notes`: what Python was asked. Programs that need root fail when called.

    A file `no-pip` in the environment breaks it.
    """

    def __init__(self, folder):
        self.root, self.stubs, self.notes = folder / "root", folder / "stubs", folder / "notes"
        self.stubs.mkdir()
        for name in FORBIDDEN:
            self.stub(name, 'echo "$0 $@ was called" >&2; exit 99')
        self.systemctl()
        self.python = self.noting("python-that-notes")

    def stub(self, name, text):
        path = self.stubs / name
        path.write_text(text if text.startswith("#!") else f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)
        return path

    def noting(self, name, base="one"):
        """A Python that notes what it is asked; `base`: which installation its environments are of."""
        told = f'  "-c import sys; print(sys.base_prefix, sys.version)") echo {base} ;;\n  "-c import sys"*)'
        text = PYTHON.format(notes=self.notes, python=sys.executable)
        return self.stub(name, text.replace('  "-c import sys"*)', told))

    def fail(self):
        """From now on no package can be installed, as long as the file is there."""
        failing = Path(f"{self.notes}.fail")
        failing.touch()
        return failing

    def systemctl(self, state=""):
        """One that answers is-active with `state`; without, any call fails."""
        answer = f'[ "$1" = is-active ] && echo {state}' if state else 'echo "$0 $@ was called" >&2; exit 99'
        self.stub("systemctl", answer)

    def run(self, *words, root=True, python=True, script=SCRIPT, within=(), **variables):
        """`within`: a command that runs it, as setpriv does. `variables`: of the surroundings."""
        command = [*within, str(script), *words]
        command += ["--root", str(self.root)] if root else []
        command += ["--python", str(self.python)] if python else []
        env = {**os.environ, "PATH": f"{self.stubs}:{os.environ['PATH']}", **variables}
        return subprocess.run(command, capture_output=True, text=True, env=env, cwd=ROOT, timeout=60, check=False)

    def installed(self, *words, script=SCRIPT):
        done = self.run(*words, script=script)
        assert done.returncode == 0, done.stdout + done.stderr
        assert done.stderr == ""
        return done.stdout

    def asked(self):
        """What Python was asked to make and to install."""
        lines = self.notes.read_text().splitlines() if self.notes.exists() else []
        return [line for line in lines if line.startswith("-m") and line != "-m pip --version"]

    def tree(self):
        """Path -> (mode, content) of everything."""
        return {
            str(p.relative_to(self.root)): (p.stat().st_mode & 0o7777, p.read_bytes() if p.is_file() else None)
            for p in self.root.rglob("*")
        }
