"""The simulated UWB tag against the codecs: every format, and the DWM1001's shell in all its moods."""

from dataclasses import dataclass, field

import pytest

from companion.core.messages import Message, UwbPosition, UwbRanges
from drivers.uwb import CODECS
from drivers.uwb.dwm1001 import Dwm1001Codec
from drivers.uwb.dwm1001_shell import ShellDialog
from sim.world.dwm1001_module import Dwm1001Module
from sim.world.uwb_tag import FORMATS, UwbTag

STEP_NS = 50_000_000
IDS = {"dwm1001": ["1151", "0CA8", "111C", "1150"], "makerfabs": ["1782", "1783", "1784", "1785"]}
PLACE = (2.55, 2.01, 1.71)


def ids(wire_format: str) -> list[str]:
    return IDS.get(wire_format.split("-", maxsplit=1)[0], ["0", "1", "2", "3"])


def make_tag(wire_format: str, **options) -> UwbTag:
    return UwbTag(wire_format, anchors={a: (1.0 * i, 8.0, 2.25) for i, a in enumerate(ids(wire_format))}, **options)


@dataclass
class Wire:
    """Tag and codec joined, with a clock of 50 ms steps. The tag's ranges grow by 0.25 m a cycle."""

    tag: UwbTag
    codec: object
    t_ns: int = 0
    sent: list[tuple[int, bytes]] = field(default_factory=list)
    messages: list[Message] = field(default_factory=list)
    ranges_m: dict[str, float | None] = field(default_factory=dict)
    plugged: bool = True
    cycle_ns: int = 0

    def run(self, seconds: float) -> list[Message]:
        before = len(self.messages)
        end_ns = self.t_ns + round(seconds * 1e9)
        while self.t_ns < end_ns:
            self.t_ns += STEP_NS
            for data in self.codec.step(self.t_ns):
                self.sent.append((self.t_ns, data))
                self.hear(self.tag.receive(data, self.t_ns))
            if self.t_ns >= self.cycle_ns:
                self.cycle_ns = self.t_ns + round(1e9 / self.tag.rate_hz)
                ranges = self.ranges_m or dict.fromkeys(ids("dwm1001"), 3.0 + self.t_ns * 2.5e-10)
                self.hear(self.tag.cycle(ranges, PLACE, self.t_ns))
        return self.messages[before:]

    def hear(self, data: bytes) -> None:
        if self.plugged:
            self.messages += self.codec.feed(data, self.t_ns)

    def told(self) -> list[bytes]:
        return [data for _, data in self.sent]


def dwm_wire(wire_format: str = "dwm1001-lec", **options) -> Wire:
    wire = Wire(make_tag(wire_format, **options), CODECS[FORMATS[wire_format]](tag="boat"))
    wire.codec.start_bytes()
    return wire


def cycles_of_ranges(messages: list[Message]) -> int:
    return sum(isinstance(m, UwbRanges) for m in messages)


@pytest.mark.parametrize("wire_format", [f for f in FORMATS if not f.startswith("dwm1001")])
def test_a_tag_that_just_talks(wire_format):
    tag, codec = make_tag(wire_format, tag_id=7), CODECS[FORMATS[wire_format]](tag="boat")
    a, b, c, d = ids(wire_format)
    (first, *place) = codec.feed(tag.cycle({a: 6.44, b: 6.5, c: None, d: 3.2}, PLACE, 1), 1)
    resolution_m = 0.1 if wire_format == "makerfabs-json" else 0.01
    found = {r.anchor: r.range_m for r in first.ranges}
    assert found == pytest.approx({a: 6.44, b: 6.5, d: 3.2}, abs=resolution_m / 2)
    assert len(place) == (wire_format == "linktrack")
    second = codec.feed(tag.cycle({a: 6.54, b: None, c: 2.0, d: 3.2}, None, 2), 2)[0]
    repeated = {b} if wire_format == "makerfabs-json" else set()
    assert {r.anchor for r in second.ranges} == {a, c, d} | repeated
    assert codec.counters.garbage == 0
    assert tag.receive(b"\r\r", 3) == b""


@pytest.mark.parametrize("wire_format", ["dwm1001-lec", "dwm1001-les", "dwm1001-lep"])
def test_a_module_after_power_on_is_brought_to_stream(wire_format):
    wire = dwm_wire(wire_format)
    assert wire.run(1.15) == []
    assert wire.sent == []
    wire.run(8.0)
    acts, aurs, command = b"acts 0 0 0 1 0 1 1 2 0\r", b"aurs 10 10\r", wire_format[-3:].encode() + b"\r"
    assert wire.told() == [b"\r", b"\r", acts, aurs, command]
    assert not wire.tag.module.stationary_detection
    assert len(wire.run(10.0)) in range(9, 23)
    assert len(wire.sent) == 5
    assert wire.codec.counters.garbage == 0
    kinds = {type(m) for m in wire.messages}
    assert kinds == ({UwbPosition} if wire_format == "dwm1001-lep" else {UwbRanges, UwbPosition})


def test_a_shell_that_was_only_just_entered_is_told_to_stream_at_once():
    """The boat must be online 3 s after its tag was plugged in: a listen, the dialogue, a cycle of 1 s."""
    wire = dwm_wire()
    wire.run(2.8)
    assert wire.messages and wire.told()[-1] == b"lec\r"
    sent = len(wire.sent)
    assert cycles_of_ranges(wire.run(20.0)) >= 19 and len(wire.sent) == sent, "once told, it is left alone"


def test_a_shell_that_was_entered_by_somebody_else_is_looked_at_first():
    wire = dwm_wire()
    wire.tag.receive(b"\r", 0)
    wire.tag.receive(b"\r", 1)
    wire.run(3.5)
    assert b"lec\r" not in wire.told(), "no banner: it may be streaming"
    wire.run(6.0)
    assert cycles_of_ranges(wire.run(10.0)) >= 9


@pytest.mark.parametrize("wire_format", ["dwm1001-lec", "dwm1001-les", "dwm1001-lep"])
def test_a_running_stream_is_found_and_not_toggled_off(wire_format):
    wire = dwm_wire(wire_format, streaming=True)
    wire.run(30.0)
    assert wire.sent == []
    assert len(wire.messages) >= 29


def test_a_stream_of_another_kind_is_taken_as_it_is():
    tag = make_tag("dwm1001-les", streaming=True)
    wire = Wire(tag, Dwm1001Codec(tag="boat", command="lec"))
    assert cycles_of_ranges(wire.run(10.0)) >= 9
    assert wire.sent == []


def test_a_module_at_rest_with_stationary_detection_is_brought_back_to_1_hz():
    """It streams at 0.1 Hz; the CRs toggle the stream off and on again, the settings do the rest."""
    wire = dwm_wire(streaming=True)
    wire.tag.module.stationary = True
    wire.run(20.0)
    assert not wire.tag.module.stationary_detection
    assert cycles_of_ranges(wire.run(10.0)) >= 9


def test_a_stream_that_was_switched_off_by_hand_is_switched_on_again():
    wire = dwm_wire(streaming=True)
    wire.run(3.0)
    wire.tag.receive(b"lec\r", wire.t_ns)
    assert wire.tag.module.stream is None
    wire.run(20.0)
    assert cycles_of_ranges(wire.run(10.0)) >= 9


def test_a_module_that_restarts_is_entered_again():
    wire = dwm_wire()
    wire.run(12.0)
    wire.tag.module = Dwm1001Module(1.0)
    wire.run(16.0)
    assert cycles_of_ranges(wire.run(10.0)) >= 9


def test_a_module_that_restarts_in_mid_dialogue_is_entered_again():
    wire = dwm_wire()
    wire.run(1.5)
    assert wire.told()[-1] == b"lec\r" and not wire.messages, "in mid dialogue: it has not begun to stream"
    wire.tag.module = Dwm1001Module(1.0)
    wire.run(15.0)
    assert cycles_of_ranges(wire.run(10.0)) >= 9


def test_a_module_that_sleeps_through_the_first_byte_is_woken():
    wire = dwm_wire()
    module, answered = wire.tag.module, wire.tag.module.receive
    heard: list[tuple[bytes, int]] = []

    def sleepy(data: bytes, t_ns: int) -> bytes:
        heard.append((data, t_ns))
        awake = any(t_ns - 200_000_000 < t <= t_ns for _, t in heard[:-1])
        return answered(data, t_ns) if awake else b""

    module.receive = sleepy
    wire.run(4.0)
    module.receive = answered
    wire.run(10.0)
    assert cycles_of_ranges(wire.run(10.0)) >= 9


def test_the_second_call_has_one_byte_more_for_a_sleeper():
    dialog = ShellDialog(1.0, "lec")
    called = [dialog.step(round(0.3e9) * k) for k in range(16)]
    assert [len(data) for data in called if data] == [2, 3, 3]


def test_a_companion_that_reconnects_leaves_the_stream_running():
    wire = dwm_wire()
    wire.run(12.0)
    told = len(wire.sent)
    wire.plugged = False
    wire.run(0.5)
    wire.plugged = True
    wire.codec.start_bytes()
    assert cycles_of_ranges(wire.run(10.0)) >= 9
    assert len(wire.sent) == told


def test_silence_of_all_anchors_does_not_end_the_stream_for_good():
    """A module out of reach may print nothing at all: whatever was toggled meanwhile must settle again."""
    wire = dwm_wire()
    wire.run(12.0)
    wire.plugged = False
    for silence_s in (7.0, 11.0, 23.0):
        wire.plugged = False
        wire.run(silence_s)
        wire.plugged = True
        wire.run(20.0)
        assert cycles_of_ranges(wire.run(10.0)) >= 9


def test_tlv_mode_answers_the_poll():
    wire = dwm_wire("dwm1001-tlv")
    wire.run(10.0)
    assert set(wire.told()) == {b"\x0c\x00"}
    assert 9 <= cycles_of_ranges(wire.messages) <= 11
    assert wire.codec.counters.reasons["refused"] == 0
    assert wire.codec.counters.reasons["truncated"] == 0
    newest = [m for m in wire.messages if isinstance(m, UwbRanges)][-1]
    assert {r.anchor for r in newest.ranges} == set(ids("dwm1001"))


def test_module_quirks():
    """The shell as its guide describes it: refusal outside, CR CR within 1 s, echo, toggle, repeat."""
    module = Dwm1001Module(1.0)
    assert module.receive(b"l", 0) == b"\x40\x01\x01"
    assert module.receive(b"\r", 0) == b""
    assert module.receive(b"\r", 1_100_000_000) == b""
    assert module.receive(b"\r", 1_200_000_000).endswith(b"dwm> ")
    assert module.receive(b"lec", 0) == b"lec"
    assert module.receive(b"\r", 0) == b"\r\ndwm> "
    assert module.stream == "lec"
    module.receive(b"\r", 0)
    assert module.stream is None
    module.receive(b"aurs 5 20\r", 0)
    assert module.rate_hz == 2.0
    assert b"unknown" in module.receive(b"aurs x y\r", 0)
    assert not module.receive(b"quit\r", 0).endswith(b"dwm> ")
    assert not module.in_shell


def test_clear_errors():
    with pytest.raises(ValueError, match=r"unknown UWB format 'dwm'; known: dwm1001-lec"):
        UwbTag("dwm", anchors={})
    with pytest.raises(ValueError, match=r"anchor ID 'A0': mauwb needs 0 to 7"):
        UwbTag("mauwb", anchors={"A0": (0.0, 0.0, 0.0)})


def test_every_format_has_a_codec_and_every_codec_a_format():
    assert set(FORMATS.values()) == set(CODECS)
