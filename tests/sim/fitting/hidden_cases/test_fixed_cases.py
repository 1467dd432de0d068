"""The fixed set of hidden-effect cases: what nobody told the tool must be found in files alone (nonce `fixed-1`)."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from companion.cli import diagnose
from companion.cli.options.parser import Parser
from tests.hidden.fixed import fixed_cases
from tests.hidden.write import write_case

TRAIN_S = 150.0
"""Half of the logs of the large benchmark: the everyday suite stays quick."""
EVERYDAY = ("thruster_gain",)
MORE = ("cg_shift", "gyro_bias", "heading_offset", "uwb_lever_arm")
"""Left to `make matrix`: `scripts/evidence diagnose` draws many of each family."""
CASES = tuple(fixed_cases(TRAIN_S))


def said_of(case: str, folder: Path) -> tuple[dict, dict]:
    """What the command says of one case, and the truth, which is in no file that it reads."""
    truth = write_case(fixed_cases(TRAIN_S)[case], folder)
    parser = Parser()
    diagnose.add_parser(parser.add_subparsers())
    logs = [str(next(folder.glob(f"{name}.*"))) for name in ("train1", "train2")]
    held = str(next(folder.glob("held_out.*")))
    out = folder / "found"
    words = ["diagnose", *logs, "--vessel", str(folder / "base.toml"), "--held-out", held, "--out", str(out)]
    args = parser.parse_args([*words, "--no-report"])
    code = args.function(args, Console(file=io.StringIO(), width=120))
    assert code in (diagnose.DONE, diagnose.LOOK)
    return json.loads((out / "findings.json").read_text()), truth


def marks(case: str) -> list[pytest.MarkDecorator]:
    if case in EVERYDAY:
        return []
    return [pytest.mark.long, pytest.mark.matrix] if case in MORE else [pytest.mark.long]


@pytest.mark.parametrize("case", [pytest.param(name, marks=marks(name)) for name in CASES])
@pytest.mark.long
def test_what_is_hidden_is_found(case: str, tmp_path: Path) -> None:
    found, truth = said_of(case, tmp_path)
    names = {cause["name"] for cause in found["causes"]}
    if case == "outside":
        assert found["verdict"] in ("unknown", "partial")
        assert found["depends_on"][0] == "speed", "a skeg's lift goes with speed"
        return
    assert names == {cause["id"] for cause in truth["causes"]}
    assert found["verdict"] == ("named" if names else "none")
    for cause in found["causes"]:
        assert cause["evidence_nats"] >= 12 and cause["size_low"] > 1
