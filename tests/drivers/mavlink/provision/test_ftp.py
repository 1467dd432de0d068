"""Putting a file on an autopilot: what is asked of it, and what becomes of refusals. The judge is a card in memory."""

import struct
import zlib

import pytest

from drivers.mavlink.provision.ftp import DATA_BYTES, FtpRefusedError, FtpReply, FtpRequest, parse_reply, upload_steps
from sim.world.autopilot.mavlink.files import FtpFiles

PATH = "/APM/scripts/gate.lua"
CREATE, WRITE, MAKE_FOLDER, CHECKSUM = 6, 7, 9, 14


class Card:
    """Answers payloads as ArduPilot 4.6, which refuses a path whose NUL is counted, and keeps the requests."""

    def __init__(self, stored=None, lost=(), refuses=None):
        self.files, self.requests, self.lost, self.refuses = (
            FtpFiles(stored, counts_nul=False),
            [],
            set(lost),
            refuses or {},
        )

    def answer(self, payload):
        number, _, opcode, size = struct.unpack_from("<HBBB", payload)
        data = payload[12 : 12 + size]
        self.requests.append((opcode, data))
        if len(self.requests) in self.lost:
            return None
        if code := self.refuses.get(opcode):
            return struct.pack("<HBBBBBBIB", (number + 1) % 65536, 0, 129, 1, opcode, 0, 0, 0, code).ljust(251, b"\0")
        return self.files.answers(payload, 0)[0]


def upload(card, content, path=PATH):
    steps, number = upload_steps(path, content), 65533
    request = next(steps)
    try:
        while True:
            number += 1
            reply = None
            while reply is None:
                heard = card.answer(request.payload(number))
                reply = heard and parse_reply(heard, request, number)
            request = steps.send(reply)
    except StopIteration:
        return card.files.stored


@pytest.mark.parametrize("size", [0, 1, DATA_BYTES - 1, DATA_BYTES, DATA_BYTES + 1, 3000])
def test_a_file_arrives_whole_and_no_path_has_its_nul_counted(size):
    content = bytes(i * 7 % 256 for i in range(size))
    card = Card({PATH: b"-- an older and longer one\n" * 300})
    assert upload(card, content) == {PATH: content}
    assert [data for opcode, data in card.requests if opcode in (CREATE, CHECKSUM)] == [PATH.encode()] * 2


def test_lost_answers_are_asked_for_again():
    content = b"local a = 1\n" * 100
    assert upload(Card(lost=(1, 2, 5, 9)), content) == {PATH: content}


def test_folders_that_are_missing_are_made():
    card = Card()
    assert upload(card, b"x", "/new/deep/a.lua") == {"/new/deep/a.lua": b"x"}
    assert [data for opcode, data in card.requests if opcode == MAKE_FOLDER] == [b"/new", b"/new/deep"]


@pytest.mark.parametrize(
    ("refuses", "words"),
    [({CREATE: 9}, "cannot be created: the file is protected"), ({WRITE: 1}, "cannot be written"), ({CHECKSUM: 10},
     "cannot be read back: file not found"), ({CREATE: 77}, "error 77")],
)  # fmt: skip
def test_a_refusal_says_what_could_not_be_done_and_why(refuses, words):
    with pytest.raises(FtpRefusedError, match=words):
        upload(Card(refuses=refuses), b"x" * 500)


def test_a_file_that_arrives_altered_is_noticed():
    card = Card()
    steps, number = upload_steps(PATH, b"what was sent"), 0
    request = next(steps)
    with pytest.raises(FtpRefusedError, match="is not what was sent"):
        while True:
            number += 1
            altered = request._replace(data=b"what arrived ") if request.opcode == WRITE else request
            request = steps.send(parse_reply(card.answer(altered.payload(number)), request, number))


def test_answers_to_other_requests_are_no_answers():
    request = FtpRequest(CREATE, 0, PATH.encode())
    (answer,) = FtpFiles().answers(request.payload(7), 0)
    assert parse_reply(answer, request, 7) == FtpReply()
    assert parse_reply(answer, request, 8) is None
    assert parse_reply(answer, FtpRequest(WRITE), 7) is None
    assert parse_reply(request.payload(8), request, 7) is None
    assert parse_reply(b"short", request, 7) is None


def test_the_checksum_is_the_protocols():
    """CRC-32 (0xEDB88320) without inversion; for 123456789 from zlib's own check value 0xCBF43926 by linearity."""
    card = Card()
    upload(card, b"123456789")
    reply = parse_reply(card.answer(FtpRequest(CHECKSUM, 0, PATH.encode()).payload(1)), FtpRequest(CHECKSUM), 1)
    zeros = zlib.crc32(bytes(9)) ^ zlib.crc32(b"123456789")  # linear: crc(m) ^ crc(0) has neither inversion
    assert struct.unpack("<I", reply.data[:4]) == (zeros,)
