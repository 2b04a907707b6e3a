"""Engine for Ray clusters: the cluster of `RAY_ADDRESS`, or a temporary local cluster."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from splatwire.errors import BackendUnavailableError
from splatwire.evaluation.study.engines import Attempts, Event, Listener, default_workers, failed
from splatwire.evaluation.study.store import Store
from splatwire.evaluation.study.units import Unit
from splatwire.evaluation.study.work import run_unit, use_one_thread

LOOPBACK = "127.0.0.1"
_STORE_BYTES = 100 << 20
"""Memory of Ray's object store on a local cluster in bytes; it only transfers short identifiers."""


@dataclass(frozen=True)
class RayEngine:
    """Executes tasks on a Ray cluster; all machines must have access to the store's folder.

    Attributes:
        workers: Number of parallel tasks; None for the capacity of the cluster.
        address: Address of a running cluster; None for `RAY_ADDRESS`, or a local cluster if that is not set.
    """

    workers: int | None = None
    address: str | None = None

    def run(self, store: Store, units: Sequence[Unit], listener: Listener) -> None:
        """Executes tasks on the cluster and writes their results into the store."""
        ray = _library()
        attempts, waiting = Attempts(listener), list(reversed(units))
        with self._connected(ray):
            most = self.workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
            task = ray.remote(num_cpus=1, max_retries=0)(_run)
            running: dict[Any, Unit] = {}
            while waiting or running:
                while waiting and len(running) < most:
                    unit = waiting.pop()
                    running[task.remote(str(store.root), unit)] = unit
                for reference in ray.wait(list(running), num_returns=1)[0]:
                    unit = running.pop(reference)
                    if (reason := _death_reason(ray, reference, unit)) is None:
                        listener(Event(unit))
                    else:
                        attempts.lost(unit, reason)
                        waiting.append(unit)

    @contextmanager
    def _connected(self, ray: Any) -> Iterator[None]:
        """Connects to a cluster, or starts a temporary one that listens on this machine only."""
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


def _death_reason(ray: Any, reference: Any, unit: Unit) -> str | None:
    """Returns why the worker process of a task died, or None if it did not die.

    Args:
        ray: The module `ray`.
        reference: Ray's reference to the result of the task.
        unit: The task.

    Raises:
        SplatwireError: If the task itself failed.
    """
    try:
        ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        cause = error.cause
        raise failed(unit, str(cause) if cause is not None else str(error)) from error
    except ray.exceptions.RayError as error:
        return f"{type(error).__name__}: {str(error).splitlines()[0]}"
    return None
