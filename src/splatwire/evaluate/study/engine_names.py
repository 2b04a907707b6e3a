"""Engines by name; each is imported when it is asked for."""

from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.evaluate.study.engines import Engine, default_workers
from splatwire.evaluate.study.slurm_options import SlurmOptions

ENGINES = ("local", "ray", "slurm")


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
