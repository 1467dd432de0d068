"""The catalogue as rows of a table, for docs/diagnose.md: a test compares them with the page."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from companion.core.configuration.vessel_file import VesselFile
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.vessel_edits.edits import EDITS
from sim.fitting.diagnose.vessel_edits.public_form import family, smallest_size
from sim.fitting.diagnose.vessel_edits.public_table import PUBLIC


def rows(vessel: VesselFile, effects: Iterable[Effect]) -> Iterator[str]:
    """One Markdown row for each family that can be named; smallest sizes are those of `vessel`."""
    seen: set[str] = set()
    for effect in effects:
        name = family(effect.name)
        if effect.family == "base" or name in seen:
            continue
        seen.add(name)
        size, unit = smallest_size(effect)
        own = {p.name: p.unit for p in effect.parameters}
        units = PUBLIC[name].units if name in PUBLIC else own
        parameters = ", ".join(f"`{key}`" + (f" [{u}]" if u != "1" else "") for key, u in units.items()) or "-"
        size_text = f"{size:.3g}" + (f" {unit}" if unit != "1" else "")
        in_file = "yes" if name in EDITS or set(effect.hooks) in ({"maps"}, {"hull"}) else "no"
        title = f"`{name}`" + (f" = `{'`, `'.join(effect.same_as)}`" if effect.same_as else "")
        equation = effect.equation.replace("|", "\\|")
        yield f"| {title} | {equation} | {parameters} | {size_text} | {effect.signature} | {in_file} |"
