"""Units on a Ray cluster: the one that `RAY_ADDRESS` names, or one that is started here and stopped again."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from splatwire.errors import BackendUnavailableError
from splatwire.evaluate.study.engines import Attempts, Event, Listener, default_workers, failed
from splatwire.evaluate.study.store import Store
from splatwire.evaluate.study.units import Unit
from splatwire.evaluate.study.work import run_unit, use_one_thread

LOOPBACK = "127.0.0.1"
_STORE_BYTES = 100 << 20
"""Of Ray's own object store on a local cluster: only keys travel through it."""


@dataclass(frozen=True)
class RayEngine:
    """A Ray cluster whose machines all see the folder of the store.

    Attributes:
        workers: Units at a time; None for what the cluster has.
        address: Address of a running cluster; None for `RAY_ADDRESS`, and for a local one where that is not set.
    """

    workers: int | None = None
    address: str | None = None

    def run(self, store: Store, units: Sequence[Unit], listener: Listener) -> None:
        """See `Engine.run`."""
        ray = _library()
        attempts, waiting = Attempts(listener), list(reversed(units))
        with self._cluster(ray):
            most = self.workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
            task = ray.remote(num_cpus=1, max_retries=0)(_run)
            running: dict[Any, Unit] = {}
            while waiting or running:
                while waiting and len(running) < most:
                    unit = waiting.pop()
                    running[task.remote(str(store.root), unit)] = unit
                for reference in ray.wait(list(running), num_returns=1)[0]:
                    unit = running.pop(reference)
                    if (reason := _lost(ray, reference, unit)) is None:
                        listener(Event(unit))
                    else:
                        attempts.lost(unit, reason)
                        waiting.append(unit)

    @contextmanager
    def _cluster(self, ray: Any) -> Iterator[None]:
        """Joins a cluster, or starts one that listens on this machine alone and is gone afterwards."""
        if ray.is_initialized():
            yield
            return
        address = self.address or os.environ.get("RAY_ADDRESS")
        quiet = {"log_to_driver": False, "logging_level": "warning"}
        if address:
            ray.init(address=address, **quiet)
        else:
            ray.init(
                num_cpus=self.workers or default_workers(),
                include_dashboard=False,
                object_store_memory=_STORE_BYTES,
                _node_ip_address=LOOPBACK,
                **quiet,
            )
        try:
            yield
        finally:
            ray.shutdown()


def _library() -> Any:
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray
    except ImportError as error:
        raise BackendUnavailableError("ray", "pip install 'splatwire[cluster]'") from error
    return ray


def _run(root: str, unit: Unit) -> str:
    use_one_thread()
    return run_unit(root, unit)


def _lost(ray: Any, reference: Any, unit: Unit) -> str | None:
    """Why the worker of a finished task was lost; None if it was not.

    Raises:
        SplatwireError: If the unit itself failed.
    """
    try:
        ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        cause = error.cause
        raise failed(unit, str(cause) if cause is not None else str(error)) from error
    except ray.exceptions.RayError as error:
        return f"{type(error).__name__}: {str(error).splitlines()[0]}"
    return None
