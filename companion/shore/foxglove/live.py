"""Live telemetry for Foxglove: a WebSocket server beside the console (`aritra shore --foxglove PORT`).

foxglove-sdk (extra `shore`) does the protocol on threads of its own; a client that is too slow loses the oldest
messages and never holds anybody up. Read-only: clients can look, and nothing else. Channels: `channels`.
"""

from __future__ import annotations

from foxglove import Context, start_server

from companion.core.configuration.tables import ConfigError
from companion.shore.foxglove.channels import FoxgloveChannels


class FoxgloveServer:
    """`see` every sample. Raises ConfigError where the port is taken."""

    def __init__(self, port: int) -> None:
        context = Context()
        try:
            self._server = start_server(
                name="aritra", host="127.0.0.1", port=port, capabilities=[], supported_encodings=[], context=context
            )
        except (RuntimeError, OSError, OverflowError) as error:
            raise ConfigError(f"--foxglove {port}: {error}") from None
        self.see = FoxgloveChannels(context).see

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.port

    def close(self) -> None:
        """No more clients."""
        self._server.stop()
