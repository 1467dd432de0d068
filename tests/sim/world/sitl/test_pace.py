"""The pace of simulated time, and the command line of the SITL simulator."""

import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.__main__ import main
from sim.world.sitl.loopback import BEHIND_NS, Pace
from tests.companion.command_line import exit_code
from tests.sim.world.sitl.sitl_fixture import MS, S


@given(st.floats(0.1, 10), st.lists(st.tuples(st.integers(1, 50 * MS), st.integers(0, 300 * MS)), max_size=100))
def test_the_pace_holds_back_and_never_makes_up(speed, frames):
    """Over any stretch simulated time gains at most the stall's allowance on `speed` times real time."""
    pace, world_ns, now_ns, start = Pace(speed), 0, 0, None
    for step_ns, busy_ns in frames:
        world_ns, now_ns = world_ns + step_ns, now_ns + busy_ns
        wait_ns = pace.wait_ns(world_ns, now_ns)
        assert wait_ns >= 0
        now_ns += wait_ns
        start = start or (world_ns, now_ns)
        assert (world_ns - start[0]) / speed <= now_ns - start[1] + BEHIND_NS + 1000


def test_without_a_speed_nothing_is_held_back():
    assert Pace(None).wait_ns(10 * S, 0) == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--ardupilot-json", "--wiring", "gate"], "--wiring: is for the simulated autopilot"),
        (["--ardupilot-json", "--udp-to", "1.2.3.4:5"], "--udp-to: is for"),
        (["--ardupilot-json", "--param", "SYSID_MYGCS=2"], "--param: is for"),
        (["--speed", "2"], "--speed: goes with --ardupilot-json"),
        (["--ardupilot-json", "nowhere"], "'nowhere': expected HOST:PORT"),
    ],
)
def test_options_that_do_not_go_together_are_refused(words, told, capsys):
    assert exit_code("sim", *words) == 2
    assert told in capsys.readouterr().err


def test_a_taken_port_is_named_with_what_to_do(tmp_path, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        taken = f"127.0.0.1:{other.getsockname()[1]}"
        assert main(["sim", "--ardupilot-json", taken, "--uwb", str(tmp_path / "tag")]) == 1
    told = capsys.readouterr().err
    assert f"udp {taken}: Address already in use" in told and "-I1" in told
    assert not (tmp_path / "tag").exists()
