"""The example notebook: its cells run in order, say what they promise, and carry no output."""

import json
import re
import subprocess
from pathlib import Path

import pytest

from companion.python_child import python

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "docs/notebooks/first-log.ipynb"
CELLS = json.loads(NOTEBOOK.read_text())["cells"]
CODE = ["".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "code"]


def test_it_is_short_and_carries_no_output():
    assert 8 <= len(CELLS) <= 14
    assert [cell for cell in CELLS if cell.get("outputs") or cell.get("execution_count")] == []


def test_its_links_lead_somewhere():
    text = "".join("".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "markdown")
    targets = re.findall(r"\]\(([^)#\s]+)", text)
    assert len(targets) >= 3 and [t for t in targets if not (NOTEBOOK.parent / t).exists()] == []


@pytest.mark.long
def test_its_cells_run(tmp_path):
    """In one process as a kernel would: seeds are in the notebook (3); the simulated boat's faults are found."""
    pytest.importorskip("polars", reason="the extra `analysis` is not installed")
    script = tmp_path / "cells.py"
    script.write_text("import matplotlib\nmatplotlib.use('Agg')\n" + "\n".join(CODE))
    env = {"OMP_NUM_THREADS": "1", "TMPDIR": str(tmp_path), "PYTHONPATH": str(ROOT), "HOME": str(tmp_path)}
    done = subprocess.run(python(str(script)), capture_output=True, text=True, cwd=tmp_path, env=env, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "Believe the structured model" in done.stdout
    gain = re.search(r"thruster_gain:front_port: gain \S+ \((\S+) to (\S+)\)", done.stdout)
    mass = re.search(r"payload: mass_kg \S+ \((\S+) to (\S+)\) kg", done.stdout)
    assert gain and float(gain[1]) < 0.6 < float(gain[2]), "of 60 %"
    assert mass and float(mass[1]) < 9.0 < float(mass[2]), "20 % of 45 kg"
