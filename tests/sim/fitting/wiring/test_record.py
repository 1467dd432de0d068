"""What is said of findings: put right, told only, left as found, contradicted, open."""

import msgspec
import pytest

from sim.fitting.wiring.record import WiringFinding, WiringReport

SWAP = WiringFinding(name="swapped:a+b", text="a and b have changed places", nats=12.0, certain=True, thrusters=True)


def changed(**keys) -> WiringFinding:
    return msgspec.structs.replace(SWAP, **keys)


@pytest.mark.parametrize(
    ("finding", "as_found", "words"),
    [
        (SWAP, False, ("a and b have changed places (12 nats", "goes on with that put right", "wiring.toml")),
        (SWAP, True, ("Left as it is (--as-found)",)),
        (changed(rivals=("a pushes the wrong way",)), False, ("hardly tell it from: a pushes the wrong way",)),
        (changed(certain=False, nats=4.0), False, ("perhaps a and b", "not clear enough", "push alone")),
        (changed(certain=False, against=("x.csv",)), False, ("perhaps", "otherwise in x.csv")),
        (changed(certain=False, rivals=("c",)), False, ("either a and b have changed places; or c", "cannot tell")),
        (changed(certain=False, rivals=("c",), test="Turn it."), False, ("either a and b", "trusted. Turn it.")),
        (changed(nats=None, logs=("x.csv",), thrusters=False), False, (", in x.csv", "what writes the log's columns")),
    ],
)
def test_each_sentence_says_what_follows(finding, as_found, words):
    (line,) = WiringReport(findings=(finding,), logs=1, as_found=as_found).lines
    assert line.startswith("Signs and sides: ") and all(word in line for word in words), line


def test_the_vessel_file_changes_with_thrusters_that_are_put_right_only():
    assert WiringReport(findings=(SWAP,)).vessel_changed
    for other in (changed(certain=False), changed(thrusters=False)):
        assert not WiringReport(findings=(other,)).vessel_changed
    assert not WiringReport(findings=(SWAP,), as_found=True).vessel_changed


def test_nothing_is_said_where_nobody_asked_or_all_is_right():
    for nothing in (WiringReport(), WiringReport(logs=2)):
        assert nothing.lines == nothing.open_lines == ()


def test_a_long_list_is_cut():
    (line,) = WiringReport(unknown=tuple("abcdefg"), logs=1).open_lines
    assert "a; or b; or c; or d; or 3 others" in line
