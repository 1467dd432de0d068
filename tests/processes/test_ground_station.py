"""Three programs on real wires: the simulator, the companion with a signing key, and a pymavlink ground station."""

import socket
import time

import pytest
from mcap.reader import make_reader
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.boat.load_run import EXAMPLES
from tests.processes.test_loopback import DRIVING_S, free_port, process, wait_for

pytestmark = pytest.mark.real_time

KEY = bytes(range(150, 182))
OTHER = bytes(range(10, 42))


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    """A running `aritra sim` on SERIAL1, whose autopilot has been given the key; ports and folder."""
    folder = tmp_path_factory.mktemp("station")
    udp, tcp, tag = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM), folder / "tag"
    command = ["sim", "--udp-to", f"127.0.0.1:{udp}", "--tcp", f"127.0.0.1:{tcp}", "--uwb", str(tag), "--serial", "1",
               "--seed", "5"]  # fmt: skip
    with process(command, folder / "sim.txt"):
        told = (folder / "sim.txt").read_text
        wait_for(lambda: "simulator: MAVLink on udp" in told(), 20.0, told)
        with socket.create_connection(("127.0.0.1", tcp), timeout=5) as usb:
            mav = wire.MAVLink(None, 255, 190)
            usb.sendall(wire.MAVLink_setup_signing_message(1, 1, KEY, 1).pack(mav))
            parser = wire.MAVLink(None)
            parser.robust_parsing = True
            end = time.monotonic() + 10
            while not any(m.get_msgbuf()[2] & 1 for m in parser.parse_buffer(usb.recv(4096)) or []):
                assert time.monotonic() < end, "the autopilot does not sign"
        yield folder, udp, tag


def companion(folder, udp, tag, key, forward=""):
    """Command line of a companion whose run file names the key; its log and what it prints."""
    text = (EXAMPLES / "aritra.toml").read_text()
    for name in ("boats", "sites", "missions"):
        text = text.replace(f'"{name}/', f'"{EXAMPLES}/{name}/')
    (folder / "boat.key").write_bytes(key)
    (folder / "boat.key").chmod(0o600)
    (folder / "run.toml").write_text(text.replace("[mavlink]", '[mavlink]\nsigning_key = "boat.key"') + forward)
    wires = ["--mavlink", f"udpin:127.0.0.1:{udp}", "--uwb", f"serial:{tag}:115200"]
    return ["run", "--config", str(folder / "run.toml"), *wires, "--log", str(folder / "run.mcap"), "--start"]


def unpacked(log):
    with log.open("rb") as file:
        reader = make_reader(file)
        return b"\n".join([m.data for _, _, m in reader.iter_messages()] + [a.data for a in reader.iter_attachments()])


@pytest.mark.long
def test_a_signed_link_and_a_station_that_takes_the_boat_away(simulator, tmp_path):
    _, udp, tag = simulator
    port = free_port(socket.SOCK_DGRAM)
    forward = f'\n[forward]\nurl = "udpout:127.0.0.1:{port}"\nwritable = true\n\n[vision]\nrate_Hz = 10.0\n'
    station = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255, source_component=190)
    out, seen = tmp_path / "out.txt", {}

    def turning():
        while m := station.recv_match():
            seen[m.get_srcComponent(), m.get_type()] = m
        servos = seen.get((1, "SERVO_OUTPUT_RAW"))
        return servos and any(abs(getattr(servos, f"servo{n}_raw") - 1500) > 30 for n in range(1, 5))

    def disarmed():
        turning()
        return not seen[1, "HEARTBEAT"].base_mode & 128

    with process(companion(tmp_path, udp, tag, KEY, forward), out) as child:
        wait_for(lambda: turning() or seen, 20.0, out.read_text)
        station.setup_signing(KEY, sign_outgoing=True)  # earlier it would be forgotten at the first MAVLink 2 frame
        wait_for(turning, DRIVING_S, out.read_text)
        assert {
            (1, "ATTITUDE"),
            (191, "HEARTBEAT"),
            (191, "RC_CHANNELS_OVERRIDE"),
            (191, "VISION_POSITION_ESTIMATE"),
        } <= set(seen)
        signing = station.mav.signing
        early = signing.badsig_count  # of the autopilot, whose clock stood still until it heard the companion
        before = signing.goodsig_count
        time.sleep(0.5)
        turning()
        assert signing.goodsig_count > before + 20 and signing.badsig_count == early < before
        station.mav.rc_channels_override_send(1, 1, *[1900] * 8)
        station.mav.command_long_send(1, 1, 400, 0, 0, 0, 0, 0, 0, 0, 0)
        wait_for(disarmed, 10.0, out.read_text)
        wait_for(lambda: not turning(), 5.0, out.read_text)
        child.terminate()
        assert child.wait(15) == 0, out.read_text()
    told = out.read_text()
    assert "time stamps go back" not in told
    assert "ground station's RC_CHANNELS_OVERRIDE not passed on" in told and "disarmed" in told
    assert int((tmp_path / "mavlink-signing-timestamp").read_text()) > 10**12
    held = unpacked(tmp_path / "run.mcap")
    assert len(held) > 100_000
    for secret in (KEY, KEY.hex().encode()):
        assert secret not in held and secret not in out.read_bytes()
    station.close()


def test_with_another_key_the_companion_says_so_and_stays_neutral(simulator, tmp_path):
    _, udp, tag = simulator
    out = tmp_path / "out.txt"
    with process(companion(tmp_path, udp, tag, OTHER), out):
        wait_for(lambda: "signed with another key than" in out.read_text(), DRIVING_S, out.read_text)
    text = out.read_text()
    assert "error: " in text and "boat.key" in text and OTHER.hex() not in text
    sticks = [m for m in unpacked(tmp_path / "run.mcap").split(b"\n") if b'"pwm_us"' in m and b'"channels"' in m]
    assert sticks and all(b'"source":"neutral"' in m for m in sticks)
