"""Two simulators that want the same wires, as processes."""

import os
import socket
import subprocess

import pytest

from companion.__main__ import main
from companion.python_child import aritra
from drivers.ports.pseudo_terminal import LinkClaim
from tests.drivers.ports.port_pairs import free_port
from tests.support.zenoh_fixture import wait_for

pytestmark = pytest.mark.real_time


def start(words, out):
    """A simulator that has told where it is, or has ended."""
    with out.open("w") as file:
        child = subprocess.Popen(aritra("sim", *words), stdout=file, stderr=subprocess.STDOUT)
    wait_for(lambda: out.read_text() or child.poll() is not None, what=out.read_text)
    return child


@pytest.mark.long
def test_a_second_simulator_on_the_same_uwb_is_refused_and_one_after_a_kill_is_not(tmp_path):
    tag, words = tmp_path / "tag", ["--udp-to", "127.0.0.1:9", "--uwb", str(tmp_path / "tag")]
    children = [start(words, tmp_path / "0.txt")]
    try:
        place = os.readlink(tag)
        children.append(start(words, tmp_path / "1.txt"))
        told = (tmp_path / "1.txt").read_text()
        assert told == (
            f"aritra sim: {tag} is held by another aritra sim: end it, or choose another --uwb (and --udp-to)\n"
        )
        assert children[1].wait(10) == 1
        assert children[0].poll() is None and os.readlink(tag) == place
        children[0].kill()
        children[0].wait(10)
        assert os.path.lexists(tag), "it had no time to take it away"
        children.append(start(words, tmp_path / "2.txt"))
        assert children[2].poll() is None and os.readlink(tag), (tmp_path / "2.txt").read_text()
    finally:
        for child in children:
            child.kill()
            child.wait(10)


def test_beside_a_firmware_the_sentence_names_the_firmware_s_option(tmp_path, capsys):
    claim, at = LinkClaim(tmp_path / "tag"), f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    try:
        assert main(["sim", "--ardupilot-json", at, "--uwb", str(tmp_path / "tag")]) == 1
    finally:
        claim.release()
    assert "is held by another aritra sim" in (told := capsys.readouterr().err) and "--ardupilot-json" in told
