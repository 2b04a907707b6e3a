"""Engines by name; each is imported when it is asked for."""

from dataclasses import dataclass

from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.evaluate.study.engines import Engine, default_workers

ENGINES = ("local", "ray", "slurm")


@dataclass(frozen=True)
class SlurmOptions:
    """Where the jobs of a Slurm cluster run, for how long, and with how much memory.

    Attributes:
        partition: Partition of the cluster; None for its default.
        account: Account that is charged; None for the user's default.
        minutes: Time limit of a job, minutes.
        memory_gb: Memory of a job, GB.

    Raises:
        InvalidValueError: If a number is not positive, or a name is empty or has white space.
    """

    partition: str | None = None
    account: str | None = None
    minutes: int = 240
    memory_gb: int = 8

    def __post_init__(self) -> None:
        for what, number in (("minutes", self.minutes), ("memory_gb", self.memory_gb)):
            if number < 1:
                raise InvalidValueError(f"{what} of a Slurm job must be 1 or more, not {number}")
        for what, name in (("partition", self.partition), ("account", self.account)):
            if name is not None and (not name or name.split() != [name]):
                raise InvalidValueError(f"the {what} of a Slurm job is one word, not {name!r:.60}")


def create_engine(name: str, workers: int | None = None, slurm: SlurmOptions | None = None) -> Engine:
    """Makes an engine.

    Args:
        name: One of `ENGINES`.
        workers: Workers at a time; None for one per processor (or for what the cluster has).
        slurm: Options of the jobs; for `slurm` only.

    Raises:
        UnknownNameError: If there is no such engine.
        BackendUnavailableError: If it is not installed, or cannot run here.
        InvalidValueError: If there would be no worker, or another engine gets options of Slurm.
    """
    if slurm is not None and name in ENGINES and name != "slurm":
        raise InvalidValueError(f"partition, account, minutes and memory_gb are for engine 'slurm', not '{name}'")
    if workers is not None and workers < 1:
        raise InvalidValueError(f"there must be at least one worker, not {workers}")
    if name == "local":
        from splatwire.evaluate.study.local_engine import LocalEngine

        return LocalEngine(workers or default_workers())
    if name == "ray":
        from splatwire.evaluate.study.ray_engine import RayEngine

        return RayEngine(workers)
    if name == "slurm":
        from splatwire.evaluate.study.slurm_engine import SlurmEngine

        return SlurmEngine(workers, options=slurm or SlurmOptions())
    raise UnknownNameError("engine", name, ENGINES)
