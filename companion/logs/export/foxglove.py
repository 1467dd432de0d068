"""A log as Foxglove's panels take it: what the live bridge would have sent (`companion.shore.foxglove`), as MCAP.

foxglove-sdk is of the extra `shore`.
"""

from __future__ import annotations

import io
from pathlib import Path

from foxglove import Context, open_mcap

from companion.core.telemetry import structs as shore
from companion.logs.log_file import LogFile
from companion.logs.page.view import FULL_HZ, samples
from companion.shore.foxglove.channels import FoxgloveChannels


def write(log: LogFile, out: Path) -> int:
    """Write the log's telemetry to a new file; the number of samples. The boat is called as its vessel file says.

    Raises LogError, ConfigError: the log does not hold its configuration; OSError.
    """
    told, context = samples(log, FULL_HZ), Context()
    about = told[0]
    assert isinstance(about, shore.About)
    channels = FoxgloveChannels(context)
    whole = io.BytesIO()  # a disk that is full is known here only to who writes to it: foxglove-sdk goes on
    with open_mcap(whole, context=context):
        for sample in told:
            at_ns = sample.t_ns + log.wall_offset_ns
            channels.see(about.vessel, shore.topic_of(sample), shore.encode(sample), at_ns)
    out.write_bytes(whole.getbuffer())
    return len(told)
