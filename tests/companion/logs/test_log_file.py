"""Reading: bit for bit where the log is sound, and never an exception where it is not."""

import random
import types
import typing
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.boat.recorder import Recorder
from companion.core.messages import Battery, Message, Tick
from companion.logs.log_file import LogEntry, LogError, LogFile, open_truth
from companion.logs.part import ChannelInfo, LogItem, LogPart
from companion.logs.schema import KINDS, RawBytes, viewer_schema

INT64 = st.integers(-(2**63), 2**63 - 1)


def values(hint: object) -> st.SearchStrategy:
    """Values of an annotation as message fields use them; floats are any finite double."""
    simple = {
        float: st.floats(allow_nan=False, allow_infinity=False),
        int: INT64,
        bool: st.booleans(),
        str: st.text(max_size=20),
        bytes: st.binary(max_size=50),
        type(None): st.none(),
    }
    if hint in simple:
        return simple[hint]  # pyright: ignore[reportArgumentType] - looked up just above
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        return st.sampled_from(args)
    if origin in (typing.Union, types.UnionType):
        return st.one_of([values(arg) for arg in args])
    if origin is tuple:
        assert args[1] is Ellipsis
        return st.lists(values(args[0]), max_size=4).map(tuple)
    if origin is dict:
        return st.dictionaries(values(args[0]), values(args[1]), max_size=3)
    assert isinstance(hint, type)
    assert issubclass(hint, msgspec.Struct)
    return structs(hint)


def structs(kind: type[msgspec.Struct]) -> st.SearchStrategy:
    return st.builds(kind, **{name: values(hint) for name, hint in typing.get_type_hints(kind).items()})


@given(st.data())
@settings(max_examples=20)
@pytest.mark.parametrize("kind", [*KINDS.values(), RawBytes], ids=lambda kind: kind.__name__)
def test_a_message_comes_back_bit_for_bit(kind, data):
    message = data.draw(structs(kind))
    topic = next((t for t, k in KINDS.items() if k is kind), "/raw/x")
    entry = LogEntry(topic, 0, 0, 0, msgspec.json.encode(message))
    back = _any_log().decode(entry)
    assert back == message
    assert repr(back) == repr(message)  # -0.0 and the types, too


def _any_log() -> LogFile:
    return LogFile.__new__(LogFile)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1))
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_floats_survive_the_whole_way_through_a_file(tmp_path_factory, numbers):
    path = tmp_path_factory.mktemp("floats") / "log.mcap"
    sent = [Battery(t_ns=k, voltage_v=number) for k, number in enumerate(numbers)]
    with Recorder(path, {}, lambda: 0, wall_offset_ns=0, background=False) as recorder:
        for message in sent:
            recorder.record(message)
    assert repr(list(LogFile(path).messages())) == repr(sent)


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> tuple[bytes, list[Message]]:
    """Bytes of a closed log of many small chunks, and its messages."""
    path = tmp_path_factory.mktemp("sound") / "log.mcap"
    dice, now = random.Random(11), [1_000_000_000]
    sent: list[Message] = []
    with Recorder(path, {"vessel": "x"}, lambda: now[0], wall_offset_ns=0, background=False) as recorder:
        for index in range(300):
            battery = Battery(t_ns=index, voltage_v=dice.random(), current_a=dice.random())
            sent += [Tick(t_ns=index, index=index), battery]
            recorder.record(sent[-2])
            recorder.record(sent[-1])
            now[0] += 1_000_000
            if index % 20 == 19:
                recorder.sync()
    return path.read_bytes(), sent


@given(cut=st.integers(1, 10**6), data=st.data())
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_a_log_cut_anywhere_gives_a_prefix_and_says_so(sound, tmp_path, cut, data):
    content, sent = sound
    cut = data.draw(st.integers(8, len(content) - 1)) if cut % 2 else 8 + cut % (len(content) - 8)
    path = tmp_path / "cut.mcap"
    path.write_bytes(content[:cut])
    log = LogFile(path)
    got = list(log.messages())
    assert got == sent[: len(got)]
    assert len(log.damage) == 1
    assert str(path) in log.damage[0]


@given(st.lists(st.tuples(st.integers(8, 10**6), st.integers(1, 255)), min_size=1, max_size=5))
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_flipped_bits_never_raise_and_never_invent(sound, tmp_path, flips):
    content, sent = sound
    broken = bytearray(content)
    for place, mask in flips:
        broken[8 + place % (len(broken) - 8)] ^= mask
    path = tmp_path / "flipped.mcap"
    path.write_bytes(broken)
    log = LogFile(path)
    remaining = iter(sent)
    assert all(message in remaining for message in log.messages())  # a subsequence of what was sent


def test_one_damaged_chunk_costs_only_itself_even_the_one_that_declares_the_channels(sound, tmp_path):
    content, sent = sound
    place = content.index(b"\x28\xb5\x2f\xfd", content.index(b"\x28\xb5\x2f\xfd") + 4)  # second zstd frame
    broken = bytearray(content)
    broken[place + 40] ^= 0xFF
    path = tmp_path / "chunk.mcap"
    path.write_bytes(broken)
    log = LogFile(path)
    got = list(log.messages())
    assert got == sent[40:]
    assert "1 damaged chunk" in log.damage[0]


@pytest.mark.parametrize(
    ("content", "reason"), [(None, "no such file"), (b"", "empty"), (b"PK\x03\x04 no log", "not an MCAP log")]
)
def test_what_is_no_log_is_refused_with_its_path(tmp_path, content, reason):
    path = tmp_path / "odd.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(LogError, match=reason) as error:
        LogFile(path)
    assert str(path) in str(error.value)


def test_a_folder_is_no_log(tmp_path):
    with pytest.raises(LogError):
        LogFile(tmp_path)


def _write(path: Path, *items: tuple[str, bytes]) -> None:
    part = LogPart(path)
    for number, (topic, data) in enumerate(items):
        part.add(LogItem(ChannelInfo(topic, "any", viewer_schema(Tick, "any")), number, 0, 0, data))
    part.finish()


def test_a_truth_of_another_version_is_told_from_a_log_without_any(tmp_path):
    path, boat = tmp_path / "truth.mcap", tmp_path / "boat.mcap"
    _write(path, ("/ground_truth", b'{"t_ns":1}'), ("/ground_truth", b'{"t_ns":2}'))
    _write(boat, ("/tick", b'{"t_ns":1,"index":2}'))
    with pytest.raises(LogError, match=r"no ground truth that this version can read; .*/ground_truth: 2 messages do"):
        open_truth(path, LogFile(boat))
    with pytest.raises(LogError, match="no ground truth; expected the simulator's own log"):
        open_truth(boat, LogFile(boat))


def test_unknown_topics_and_undecodable_messages_are_counted_not_fatal(tmp_path):
    path = tmp_path / "odd.mcap"
    _write(
        path,
        ("/future", b"{}"),
        ("/tick", b'{"t_ns":1,"index":2,"new_field":3}'),
        ("/battery", b'{"t_ns":1,"voltage_v":null}'),
        ("/battery", b"not json"),
        ("/future", b"{}"),
    )
    log = LogFile(path)
    assert list(log.messages()) == [Tick(t_ns=1, index=2)]
    assert log.unknown == {"/future": 2}
    assert log.undecodable == {"/battery": 2}
    assert log.damage == [f"{path}: /battery: 2 messages do not fit their class in this version: left out"]
    assert list(log.messages(Tick)) and not log.damage  # nothing that was asked for is missing


def test_an_unreadable_later_part_is_told_and_the_rest_is_read(tmp_path):
    path = tmp_path / "log.mcap"
    _write(path, ("/tick", b'{"t_ns":1,"index":0}'))
    (tmp_path / "log.part1.mcap").touch()
    _write(tmp_path / "log.part2.mcap", ("/tick", b'{"t_ns":2,"index":1}'))
    _write(tmp_path / "other.part1.mcap", ("/tick", b'{"t_ns":9,"index":9}'))
    log = LogFile(path)
    assert [message.t_ns for message in log.messages()] == [1, 2]
    assert len(log.damage) == 1
    assert "part1" in log.damage[0]


def test_kinds_are_selected_and_the_order_is_the_order_written(drive_log):
    log = LogFile(drive_log(2.0))
    everything = [message for message in log.messages() if isinstance(message, Tick | Battery)]
    assert list(log.messages(Tick, Battery)) == everything
    assert log.metadata["vessel"] == "synthetic"
    assert log.attachments["vessel.toml"] == b'name = "synthetic"\n'
    assert log.wall_offset_ns > 0
    log.metadata["wall_offset_ns"] = "soon"
    with pytest.raises(LogError, match=r"metadata: wall_offset_ns: 'soon' is no whole number"):
        print(log.wall_offset_ns)
