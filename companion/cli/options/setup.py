"""The run file's setup, with files of the command line instead of some that it names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from companion.boat.load_run import RunSetup, read_texts, refuse_unfit, setup_of
from companion.cli.options.files import text_of
from companion.core.model.actuators.propulsion import only_fixed


def setup_instead(
    config: Path, instead: Mapping[str, Path | None], what: str, *, mission: Path | None = None, driven: bool = True
) -> RunSetup:
    """Setup of `config` with `instead`, by role (vessel.toml ..; None: the run file's); its own excitation is left out.

    Boats with servos are refused, `what` in their sentence; with `driven` also a mission that the boat cannot drive at
    that site. Raises ConfigError.
    """
    texts, names = read_texts(config, mission=mission)
    texts.pop("excitation.toml", None)
    for role, path in instead.items():
        if path:
            texts[role], names[role] = text_of(path), str(path)
    setup = setup_of(texts, names)
    only_fixed(setup.pilot.vessel, names["vessel.toml"], what)
    if driven:
        refuse_unfit(setup, names)
    return setup
