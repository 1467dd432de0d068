"""deploy/zenoh/make-certificates: where it writes, and how a certificate is renewed. What they are good for is in
tests/companion/boat/test_telemetry_security.py.
"""

import os
import shutil
import subprocess

import pytest

from companion.boat.load_run import EXAMPLES

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not on this machine")


def make(cwd, *names, **variables):
    command = [EXAMPLES / "zenoh/make-certificates", "pki", "shore.example.org", *names]
    env = {**os.environ, **variables}
    return subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=20, check=True)


def test_they_go_into_the_folder_named_wherever_cd_may_go(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / "pki").mkdir(parents=True)
    make(tmp_path, "aritra", CDPATH=str(elsewhere))
    assert (tmp_path / "pki/aritra.key").exists() and not list((elsewhere / "pki").iterdir())


def test_one_that_was_removed_is_renewed_by_the_same_authority(tmp_path):
    pki = tmp_path / "pki"
    make(tmp_path, "aritra", "anna")
    before = {path.name: path.read_bytes() for path in pki.iterdir()}
    assert "left as it is" in make(tmp_path, "aritra").stderr, "nothing is renewed by itself"
    (pki / "aritra.pem").unlink()
    assert make(tmp_path, "aritra", "anna").stdout.split() == ["pki/aritra.pem"]
    changed = {path.name for path in pki.iterdir() if path.read_bytes() != before[path.name]}
    assert changed - {"ca.srl"} == {"aritra.pem", "aritra.key"}
    subprocess.run(
        ["openssl", "verify", "-CAfile", pki / "ca.pem", pki / "aritra.pem"], check=True, capture_output=True
    )
