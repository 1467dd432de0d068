"""The configuration of a logged run, from the log's metadata, and the origin of its time."""

from __future__ import annotations

from companion.boat.load_run import RunSetup, setup_of
from companion.logs.log_file import LogError, LogFile
from companion.logs.metadata import files_in

CONFIGURATION = ("run.toml", "vessel.toml", "site.toml", "mission.")


def setup_in(log: LogFile) -> RunSetup:
    """The run's complete configuration. Raises LogError where the log does not hold all of it, ConfigError."""
    texts = files_in(log.metadata)
    missing = [name for name in CONFIGURATION if not any(text.startswith(name) for text in texts)]
    if missing:
        raise LogError(f"{log.path}: holds no configuration ({', '.join(missing)}): not a log of `aritra run`")
    return setup_of(texts, {name: f"{log.path}: {name}" for name in texts})


def zero_ns_of(log: LogFile) -> int:
    """`t_ns` of the first message: t_s = 0 in everything that is made of the log; 0 where it has none."""
    again = LogFile(log.path)  # so that what `log` has told of damage stays
    return next((message.t_ns for message in again.messages()), 0)
