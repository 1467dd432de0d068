from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mavlink.statustext import MAX_PENDING, TIMEOUT_NS, ChunkJoiner, Text

LONG = "PreArm: " + "compass not healthy, " * 6 + "end"


def chunks(text: str) -> list[bytes]:
    """As ArduPilot cuts it; an empty chunk follows where the text fills the last one."""
    raw = text.encode()
    return [raw[i : i + 50] for i in range(0, len(raw) + 1, 50)]


def test_a_short_text_comes_at_once():
    assert ChunkJoiner().add(2, b"Arm: refused", 0, 0, 0) == [Text(2, "Arm: refused")]


@settings(deadline=None)
@given(st.text(alphabet=st.characters(codec="ascii", min_codepoint=32), max_size=400), st.randoms())
def test_chunks_join_in_any_order(text: str, rng):
    joiner, parts = ChunkJoiner(), list(enumerate(chunks(text)))
    rng.shuffle(parts)
    out = [t for seq, raw in parts for t in joiner.add(4, raw, 7, seq, 0)]
    assert out == [Text(4, text)]
    assert joiner.expire(10 * TIMEOUT_NS) == []


def test_a_missing_chunk_shows_after_the_time_out():
    joiner = ChunkJoiner()
    first, _, last = chunks(LONG)
    assert joiner.add(3, first, 1, 0, 0) == joiner.add(3, last, 1, 2, 0) == []
    assert joiner.expire(TIMEOUT_NS) == []
    assert joiner.expire(TIMEOUT_NS + 1) == [Text(3, (first + b"[...]" + last).decode())]


def test_a_missing_end_shows_too():
    joiner = ChunkJoiner()
    joiner.add(3, chunks(LONG)[0], 1, 0, 0)
    assert joiner.expire(TIMEOUT_NS + 1) == [Text(3, LONG[:50] + "[...]")]


def test_two_texts_at_once_and_no_unbounded_memory():
    joiner = ChunkJoiner()
    a, b = chunks("a" * 60), chunks("b" * 60)
    assert joiner.add(1, a[0], 1, 0, 0) == joiner.add(2, b[0], 2, 0, 0) == []
    assert joiner.add(1, a[1], 1, 1, 0) == [Text(1, "a" * 60)]
    assert joiner.add(2, b[1], 2, 1, 0) == [Text(2, "b" * 60)]
    early = [t for i in range(1, 101) for t in joiner.add(5, b"x" * 50, i, 200, 0)]
    assert len(early) == 100 - MAX_PENDING
    assert early[0] == Text(5, "[...]" + "x" * 50 + "[...]")


def test_what_is_no_text_is_replaced():
    assert ChunkJoiner().add(6, b"\xff ok \0hidden", 0, 0, 0) == [Text(6, "� ok ")]
