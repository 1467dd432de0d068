"""File transfer, as a client sees it; packed parameters are read by MAVProxy's decoder."""

import struct

import pytest
from MAVProxy.modules.lib.param_ftp import ftp_param_decode
from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot.mavlink.files import FtpFiles, checksum
from sim.world.autopilot.parameter_table import TABLE
from tests.sim.world.autopilot.autopilot_fixture import Bench, of_type, texts

ACK, NAK = 128, 129
TERMINATE, LIST, OPEN, READ, CREATE, WRITE, REMOVE, RENAME, CHECKSUM, BURST = 1, 3, 4, 5, 6, 7, 8, 13, 14, 15
SCRIPT = b"/APM/scripts/gate.lua"


class Client:
    """One peer; `ask` gives opcode and data of each answer."""

    def __init__(self, **rover):
        self.bench = Bench(**rover)
        self.sequence = 0

    def ask(self, opcode, data=b"", offset=0, size=None, session=0):
        self.sequence += 3
        head = struct.pack(
            "<HBBBBBBI", self.sequence, session, opcode, len(data) if size is None else size, 0, 0, 0, offset
        )
        message = wire.MAVLink_file_transfer_protocol_message(0, 1, 1, (head + data).ljust(251, b"\0"))
        got = [bytes(m.payload) for m in of_type(self.bench.send(message), "FILE_TRANSFER_PROTOCOL")]
        assert [struct.unpack_from("<H", p)[0] for p in got] == [self.sequence + 1 + k for k in range(len(got))]
        return [(p[3], p[12 : 12 + p[4]]) for p in got]


def test_a_file_goes_there_and_back():
    client, content = Client(), bytes(range(256)) * 3
    assert client.ask(CREATE, SCRIPT) == [(ACK, b"")]
    for at in range(0, len(content), 200):
        assert client.ask(WRITE, content[at : at + 200], at) == [(ACK, b"")]
    assert client.ask(TERMINATE) == [(ACK, b"")]
    assert client.ask(CHECKSUM, SCRIPT) == [(ACK, struct.pack("<I", checksum(content)))]
    assert client.ask(LIST, b"/APM/scripts/") == [(ACK, b"Fgate.lua\t768\0")]
    assert client.ask(OPEN, SCRIPT) == [(ACK, struct.pack("<I", len(content)))]
    pieces = client.ask(BURST, size=239)
    assert b"".join(data for kind, data in pieces if kind == ACK) == content
    assert pieces[-1] == (NAK, b"\x06")
    assert client.ask(READ, size=80, offset=700) == [(ACK, content[700:])]


@pytest.mark.parametrize("firmware, answer", [("4.6", (NAK, b"\x03")), ("4.7", (ACK, b""))])
def test_a_path_that_is_counted_with_its_nul_is_for_4_7_alone(firmware, answer):
    client = Client(firmware=firmware)
    assert client.ask(CREATE, SCRIPT + b"\0") == [answer]


def test_one_file_at_a_time_and_another_session_waits_until_it_is_idle():
    client = Client()
    client.ask(CREATE, SCRIPT)
    assert client.ask(CREATE, b"/APM/scripts/b.lua") == [(NAK, b"\x01")]
    assert client.ask(CREATE, b"/APM/scripts/b.lua", session=1) == [(NAK, b"\x04")]
    client.bench.run(3.1)
    assert client.ask(CREATE, b"/APM/scripts/b.lua", session=1) == [(ACK, b"")]


def test_an_answer_that_was_lost_is_given_again_and_nothing_is_done_twice():
    files = FtpFiles()
    request = (struct.pack("<HBBBBBBI", 7, 0, CREATE, len(SCRIPT), 0, 0, 0, 0) + SCRIPT).ljust(251, b"\0")
    assert files.answers(request, 0) == files.answers(request, 1)


def test_refusals():
    client = Client()
    assert client.ask(OPEN, b"/nowhere") == client.ask(REMOVE, b"/nowhere") == [(NAK, b"\x0a")]
    assert client.ask(CREATE, b"/nowhere/x.lua") == client.ask(RENAME, b"/no\0/yes") == [(NAK, b"\x0a")]
    assert client.ask(READ, size=80) == client.ask(WRITE, b"x") == [(NAK, b"\x0a")]
    assert client.ask(77) == [(NAK, b"\x01")]
    assert texts(client.bench.got["boat"])[-1] == (7, "Unsupported FTP: 77")


@pytest.mark.parametrize("asked", [b"", b"?withdefaults=1"])
def test_parameters_in_one_file_are_those_of_the_download(asked):
    client = Client(changes={"RC_OVERRIDE_TIME": 0.75})
    client.ask(OPEN, b"@PARAM/param.pck" + asked)
    content = b"".join(data for kind, data in client.ask(BURST, size=239) if kind == ACK)
    decoded = ftp_param_decode(content)
    values = {name.decode(): value for name, value, _ in decoded.params}
    store = client.bench.rover.vehicle.parameters
    assert values == pytest.approx({row.name: store[row.name] for row in TABLE})
    if asked:
        defaults = {name.decode(): value for name, value, _ in decoded.defaults}
        assert defaults == pytest.approx({row.name: row.default for row in TABLE})
