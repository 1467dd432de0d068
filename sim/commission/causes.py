"""What else is wrong with the boat: the diagnosis of all logs, with the identified file as what is believed.

Causes of the day (current, wind, waves) are left out of the file: they will be others tomorrow.
"""

from __future__ import annotations

from dataclasses import dataclass

from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.commission.belief import BoatBelief
from sim.fitting.diagnose.job import diagnose
from sim.fitting.engine.split import LEAST_FIT_S

DAY = ("current", "wind", "waves")
"""Terms of a vessel file that belong to the day."""
ASKED = (
    "heading_offset", "hard_iron", "imu_lever_arm", "uwb_lever_arm", "uwb_latency", "gnss_lever_arm", "gnss_latency",
    "advance_loss",
)  # fmt: skip
"""Causes that the fit has asked for already, with current and wind beside them."""
OF_THE_DAY = "environment"
"""Family of the catalogue's effects that do."""


@dataclass(frozen=True)
class Causes:
    """`lines`: each cause in a sentence. `vessel`: the file with those of the boat; None: there are none."""

    lines: tuple[str, ...]
    vessel: VesselFile | None


def causes(belief: BoatBelief, proof: Run) -> Causes:
    """Diagnose the logs of the belief, judged on the proof. Raises ValueError naming a log that cannot be used."""
    runs = [log.run for log in belief.logs if log.run.table["t_s"].to_numpy()[-1] >= LEAST_FIT_S]
    found = diagnose(runs, belief.vessel, held_out=[proof], without=ASKED, adequacy=None, identifiability=None)
    lines = tuple(
        f"{one.effect.id}: "
        + ", ".join(f"{name} {form.value:.3g} ± {1.96 * form.se:.2g} {form.unit}" for name, form in one.numbers.items())
        for one in found.causes
    )
    own = [one for one in found.causes if one.effect.family != OF_THE_DAY]
    if not own:
        return Causes(lines, None)
    extended = found.files.extended
    terms = {name: values for name, values in extended.terms.items() if name not in DAY}
    kept = {name: values for name, values in belief.vessel.terms.items() if name in DAY}
    return Causes(lines, replace(extended, terms=terms | kept))
