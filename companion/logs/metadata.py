"""What a log says about itself: vessel, configuration, versions."""

from __future__ import annotations

import hashlib
import platform
import subprocess
import tomllib
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from companion.core.configuration.site_file import Site, load_site


def log_metadata(vessel: str, files: Mapping[str, str]) -> dict[str, str]:
    """Metadata of a log: vessel, configuration (text and SHA-256), versions. `files`: name -> text."""
    return {
        "vessel": vessel,
        "config_sha256": config_sha256(files),
        **{f"config/{name}": content for name, content in files.items()},
        "version": version("aritra"),
        "git_revision": _git_revision(),
        "python": platform.python_version(),
        "machine": platform.platform(),
    }


def config_sha256(files: Mapping[str, str]) -> str:
    """SHA-256 of the texts, in the order of their names."""
    return hashlib.sha256("".join(files[name] for name in sorted(files)).encode()).hexdigest()


def files_in(metadata: Mapping[str, str]) -> dict[str, str]:
    """The configuration files of a log's metadata: name -> text."""
    return {key.removeprefix("config/"): text for key, text in metadata.items() if key.startswith("config/")}


def site_in(metadata: Mapping[str, str], log: Path) -> Site | None:
    """The site file in a log's metadata; None without one. Raises ConfigError where this version refuses it: positions
    and headings would be in other axes.
    """
    text = metadata.get("config/site.toml")
    return None if text is None else load_site(text, name=f"{log}: site.toml")


def channels_in(metadata: Mapping[str, str]) -> dict[str, int]:
    """RC channel (0: not stated) by name of thruster, then of servo, in a log's vessel file of whatever version.

    Empty without a file.
    """
    try:
        thrusters = tomllib.loads(metadata["config/vessel.toml"])["thrusters"]
        servos = [t[key] for t in thrusters for key in ("steering", "rudder") if key in t]
        return {str(one["name"]): int(one.get("channel", 0)) for one in (*thrusters, *servos)}
    except (KeyError, TypeError, ValueError):  # a TOMLDecodeError is a ValueError
        return {}


def _git_revision() -> str:
    """Commit of the checkout that runs, `-dirty` where it has changes; `unknown` outside a checkout."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        answer = subprocess.run(
            command, cwd=Path(__file__).parent, capture_output=True, text=True, timeout=5, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return answer.stdout.strip()
