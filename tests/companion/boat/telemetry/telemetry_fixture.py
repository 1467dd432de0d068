"""Telemetry of a boat to a router on this machine."""

from companion.core.configuration.run_file import TelemetryLink


def link_to(port, **more):
    return TelemetryLink(connect=(f"tcp/127.0.0.1:{port}",), **more)
