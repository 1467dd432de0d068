"""Cases on a Dask cluster. Its workers need this program; a worker that dies is made up for by others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import TracebackType

from distributed import Client, as_completed
from distributed.scheduler import KilledWorker

from sim.campaign.runners.job import CaseOutcome, RunnerLost, Work, died
from sim.campaign.runners.worker import run_work

CONNECT_S = 10.0
"""How long a scheduler may take to answer; assumed."""


class Cluster:
    """A `Runner` on the cluster of the scheduler at `address` (tcp://host:8786). Raises RunnerLost."""

    def __init__(self, address: str):
        try:
            self._client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise RunnerLost(f"no Dask scheduler answers at {address}: {error or type(error).__name__}") from None
        self._address = address

    @property
    def workers(self) -> int:
        """How many are there now."""
        return len(self._client.scheduler_info(n_workers=-1)["workers"])

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """What has not been run is taken back."""
        self._client.close()

    def __call__(self, works: Sequence[Work]) -> Iterator[CaseOutcome]:
        """Outcomes as they come."""
        futures = self._client.map(run_work, works, pure=False, key="aritra-campaign")
        asked = dict(zip((f.key for f in futures), works, strict=True))
        coming = as_completed(futures, loop=self._client.loop)
        del futures
        for future in coming:
            work = asked.pop(future.key)
            if future.status == "finished":
                outcome = future.result()
            elif future.status == "error" and isinstance(future.exception(), KilledWorker):
                outcome = died(work)
            elif future.status == "error":
                raise RunnerLost(f"{self._address}: a worker cannot run cases: {future.exception()!r}")
            else:
                raise RunnerLost(f"{self._address}: the scheduler is gone")
            future.release()
            yield outcome
