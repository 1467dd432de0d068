"""A user's own entries of the catalogue, from a Python file with `effects(vessel) -> iterable[Effect]`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from runpy import run_path
from typing import Any

from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.catalogue.user_hooks import guarded, try_hooks


def user_effects(path: Path) -> Callable[[VesselFile], Sequence[Effect]]:
    """The file's function `effects`, whose result is checked when it is called: each hook is tried once.

    ConfigError with the file's name where it cannot be run, defines no `effects`, yields anything but `Effect`, or has
    a hook that goes wrong, then or in a fit. OSError where it cannot be read. The file is run as Python:
    name only one that you trust.
    """
    try:
        made: dict[str, Any] = run_path(str(path))
    except OSError:
        raise
    except Exception as error:  # any error of a user's file is reported with the file's name
        raise ConfigError(f"{path}: {type(error).__name__}: {error}") from error
    if not callable(made.get("effects")):
        raise ConfigError(f"{path}: defines no function effects(vessel)")

    def checked(vessel: VesselFile) -> Sequence[Effect]:
        try:
            found = tuple(made["effects"](vessel))
        except Exception as error:  # as above
            raise ConfigError(f"{path}: effects: {type(error).__name__}: {error}") from error
        for one in found:
            if not isinstance(one, Effect):
                raise ConfigError(f"{path}: effects: expected Effect, found {type(one).__name__}")
        found = tuple(guarded(one, str(path)) for one in found)
        for one in found:
            try_hooks(one, vessel, str(path))
        return found

    return checked
