"""Units on a Slurm cluster, through submitit: jobs that each take a share of the units and write them one by one."""

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from splatwire.errors import BackendUnavailableError
from splatwire.evaluate.study.engines import MAX_ATTEMPTS, Attempts, Event, Listener, failed
from splatwire.evaluate.study.slurm_options import SlurmOptions
from splatwire.evaluate.study.store import Store
from splatwire.evaluate.study.units import Unit
from splatwire.evaluate.study.work import run_unit, use_one_thread

_DEFAULT_WORKERS = 8
_POLL_S = 1.0


@dataclass(frozen=True)
class SlurmEngine:
    """Jobs of a Slurm cluster whose machines all see the folder of the store.

    A job that dies costs the unit that it worked on: what it had finished is in the store, and the rest of its share is
    submitted again.

    Attributes:
        workers: Jobs at a time; None for 8.
        cluster: `slurm`; submitit's `local` and `debug` run the jobs on this machine.
        options: Where jobs run, for how long, and with how much memory.
    """

    workers: int | None = None
    cluster: str = "slurm"
    options: SlurmOptions = field(default_factory=SlurmOptions)

    def __post_init__(self) -> None:
        """Checks before the work that jobs can be submitted.

        Raises:
            BackendUnavailableError: If submitit is not installed, or this machine has no sbatch.
        """
        _submitit()
        if self.cluster == "slurm" and shutil.which("sbatch") is None:
            raise BackendUnavailableError("slurm", "this machine has no sbatch: start it where jobs can be submitted")

    def run(self, store: Store, units: Sequence[Unit], listener: Listener) -> None:
        """See `Engine.run`."""
        executor = self._executor(store)
        attempts = Attempts(listener)
        left = {unit.key: unit for unit in units}
        while left:
            waiting = list(left.values())
            count = min(len(waiting), self.workers or _DEFAULT_WORKERS)
            jobs = {executor.submit(_run, str(store.root), waiting[i::count]): waiting[i::count] for i in range(count)}
            while jobs:
                _tell(store, left, listener)
                for job in [job for job in jobs if job.done()]:
                    share = jobs.pop(job)
                    _tell(store, left, listener)
                    unfinished = [unit for unit in share if unit.key in left]
                    if unfinished:
                        attempts.lost(unfinished[0], _reason(job, unfinished[0]))
                if jobs:
                    time.sleep(_POLL_S)

    def _executor(self, store: Store) -> Any:
        executor = _submitit().AutoExecutor(folder=str(store.root / "jobs"), cluster=self.cluster)
        executor.update_parameters(name="splatwire", cpus_per_task=1, **self.parameters())
        return executor

    def parameters(self) -> dict[str, Any]:
        """Parameters of submitit that the options mean."""
        options = self.options
        common = {"timeout_min": options.minutes, "mem_gb": options.memory_gb}
        if self.cluster != "slurm":
            return common
        named = {"slurm_partition": options.partition, "slurm_account": options.account}
        parallel = {"slurm_array_parallelism": self.workers or _DEFAULT_WORKERS}
        return {**common, **parallel, **{name: value for name, value in named.items() if value is not None}}


def _submitit() -> Any:
    try:
        import submitit
    except ImportError as error:
        raise BackendUnavailableError("slurm", "pip install 'splatwire[cluster]'") from error
    return submitit


def _tell(store: Store, left: dict[str, Unit], listener: Listener) -> None:
    """Takes what is finished by now off the list."""
    for key in [key for key, unit in left.items() if unit.is_done(store)]:
        listener(Event(left.pop(key)))


def _run(root: str, units: Sequence[Unit]) -> dict[str, str] | None:
    """A job: its units one after another; returns the unit that failed by itself, with what was wrong."""
    use_one_thread()
    for unit in units:
        try:
            run_unit(root, unit)
        except Exception as error:
            return {"unit": unit.key, "problem": str(error) or type(error).__name__}
    return None


def _reason(job: Any, unit: Unit) -> str:
    """Why a job ended early.

    Raises:
        SplatwireError: If a unit itself failed.
    """
    lost = job.exception()
    if lost is not None:
        return f"{type(lost).__name__}: {str(lost).splitlines()[0]}"
    problem = job.result()
    if problem is not None:
        raise failed(unit, problem["problem"])
    return f"the job ended without a word (tried up to {MAX_ATTEMPTS} times)"
