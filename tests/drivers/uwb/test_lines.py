"""The bounded line splitter, against a plain split of the whole input."""

from hypothesis import given
from hypothesis import strategies as st

from drivers.uwb.lines import LineSplitter

CHUNKS = st.lists(st.text(alphabet="ab,\r\n", max_size=9).map(str.encode), max_size=30)
LIMIT = 12


@given(CHUNKS)
def test_any_chunking_gives_what_a_plain_split_gives(chunks):
    splitter = LineSplitter(LIMIT)
    found = [line for chunk in chunks for line in splitter.push(chunk)]
    *plain, tail = b"".join(chunks).split(b"\n")
    expected = [None if len(line) > LIMIT else line.strip() for line in plain]
    expected += [None] * (len(tail) > LIMIT)
    assert found == [line for line in expected if line != b""]


def test_memory_stays_bounded_and_the_next_line_survives():
    splitter = LineSplitter(1024)
    found = []
    for _ in range(2000):
        found += splitter.push(b"x" * 1000)
        assert len(splitter.tail) <= 1024
    assert found == [None]
    assert splitter.push(b"x\nPOS\n") == [b"POS"]
