"""Engine for Slurm clusters, through submitit; each job executes a share of the tasks one after another."""

import shutil
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from splatwire.errors import BackendUnavailableError
from splatwire.evaluation.study.engines import MAX_ATTEMPTS, Attempts, Event, Listener, failed
from splatwire.evaluation.study.slurm_options import SlurmOptions
from splatwire.evaluation.study.store import Store
from splatwire.evaluation.study.units import Unit
from splatwire.evaluation.study.work import run_unit, use_one_thread

_DEFAULT_WORKERS = 8
_POLL_S = 1.0


@dataclass(frozen=True)
class SlurmEngine:
    """Executes tasks in jobs of a Slurm cluster; all machines must have access to the store's folder.

    Attributes:
        workers: Number of concurrent jobs; None for 8.
        cluster: `slurm`; submitit's `local` and `debug` run the jobs on this machine.
        options: Partition, account, time limit and memory of the jobs.
    """

    # If a job dies, only its current task is lost: the remaining tasks are submitted again. If the execution ends
    # early, by an error or Ctrl-C, its jobs are cancelled.

    workers: int | None = None
    cluster: str = "slurm"
    options: SlurmOptions = field(default_factory=SlurmOptions)

    def __post_init__(self) -> None:
        """Checks that submitit can submit jobs, before any result is computed.

        Raises:
            BackendUnavailableError: If submitit is not installed, or this machine has no sbatch or no srun.
        """
        _submitit()
        for name in ("sbatch", "srun") if self.cluster == "slurm" else ():
            if shutil.which(name) is None:
                reason = f"this machine has no {name}: start it where jobs can be submitted"
                raise BackendUnavailableError("slurm", reason)

    def run(self, store: Store, units: Sequence[Unit], listener: Listener) -> None:
        """Submits jobs that execute the tasks and write their results into the store."""
        executor = self._executor(store)
        attempts = Attempts(listener)
        left = {unit.key: unit for unit in units}
        jobs: dict[Any, list[Unit]] = {}
        try:
            while left:
                waiting = list(left.values())
                count = min(len(waiting), self.workers or _DEFAULT_WORKERS)
                for i in range(count):
                    jobs[_submitted(executor, str(store.root), waiting[i::count])] = waiting[i::count]
                while jobs:
                    _report_finished(store, left, listener)
                    for job in [job for job in jobs if job.done()]:
                        share = jobs.pop(job)
                        _report_finished(store, left, listener)
                        unfinished = [unit for unit in share if unit.key in left]
                        if unfinished:
                            attempts.lost(unfinished[0], _reason(job, unfinished[0]))
                    if jobs:
                        time.sleep(_POLL_S)
        finally:
            for job in jobs:
                _cancel(job)

    def _executor(self, store: Store) -> Any:
        executor = _submitit().AutoExecutor(folder=str(store.root / "jobs"), cluster=self.cluster)
        executor.update_parameters(name="splatwire", cpus_per_task=1, **self.parameters())
        return executor

    def parameters(self) -> dict[str, Any]:
        """Returns the options for the cluster under the names that the package submitit uses."""
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


def _submitted(executor: Any, root: str, units: Sequence[Unit]) -> Any:
    """Submits a Slurm job that executes tasks of an evaluation; returns submitit's handle of the job.

    Raises:
        BackendUnavailableError: If the cluster refuses the job, for example because the partition does not exist.
    """
    try:
        return executor.submit(_run, root, units)
    except RuntimeError as error:  # submitit's error for a failed sbatch
        lines = [line for line in str(error).splitlines() if line.startswith("sbatch:")] or [str(error)]
        raise BackendUnavailableError("slurm", f"the job was refused: {'; '.join(lines)}") from error


def _cancel(job: Any) -> None:
    """Cancels an unfinished cluster job, and ignores errors of the cluster."""
    try:
        job.cancel(check=False)
    except (OSError, subprocess.SubprocessError):
        return


def _report_finished(store: Store, left: dict[str, Unit], listener: Listener) -> None:
    """Calls the listener for each task whose results have appeared in the store, and removes the task from `left`.

    Args:
        store: Store in which finished results appear.
        left: Remaining tasks by key; changed in place.
        listener: Called for every finished task.
    """
    for key in [key for key, unit in left.items() if unit.is_done(store)]:
        listener(Event(left.pop(key)))


def _run(root: str, units: Sequence[Unit]) -> dict[str, str] | None:
    """Executes the tasks of a cluster job sequentially, and stops at the first failure.

    Args:
        root: Folder of the store.
        units: The tasks.

    Returns:
        Key (`unit`) and error message (`problem`) of the failed task; None if all tasks succeeded.
    """
    use_one_thread()
    for unit in units:
        try:
            run_unit(root, unit)
        except Exception as error:
            return {"unit": unit.key, "problem": str(error) or type(error).__name__}
    return None


def _reason(job: Any, unit: Unit) -> str:
    """Returns why a cluster job ended before all its tasks were finished.

    Raises:
        SplatwireError: If a task itself failed.
    """
    lost = job.exception()
    if lost is not None:
        first, _, _ = str(lost).partition("\n")
        return f"{type(lost).__name__}: {first}"
    problem = job.result()
    if problem is not None:
        raise failed(unit, problem["problem"])
    return f"the job ended without a word (tried up to {MAX_ATTEMPTS} times)"
