"""Engines that execute the tasks of an evaluation (local, Ray, Slurm), created by name and imported on demand."""

from splatwire.arguments import checked
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.evaluation.study.engines import Engine, default_workers
from splatwire.evaluation.study.local_engine import LocalEngine
from splatwire.evaluation.study.slurm_options import SlurmOptions

ENGINES = ("local", "ray", "slurm")


@checked
def create_engine(name: str, workers: int | None = None, slurm: SlurmOptions | None = None) -> Engine:
    """Creates the engine that executes the tasks of an evaluation.

    Args:
        name: One of `ENGINES`.
        workers: Number of parallel workers; None for the default of the engine.
        slurm: Options of the cluster jobs; only for `slurm`.

    Raises:
        UnknownNameError: If the engine does not exist.
        BackendUnavailableError: If the engine is not installed, or cannot run here.
        InvalidValueError: If the number of workers is below 1, or another engine gets Slurm options.
    """
    if slurm is not None and name in ENGINES and name != "slurm":
        raise InvalidValueError(f"partition, account, minutes and memory_gb are for engine 'slurm', not '{name}'")
    if workers is not None and workers < 1:
        raise InvalidValueError(f"there must be at least one worker, not {workers}")
    if name == "local":
        return LocalEngine(workers or default_workers())
    if name == "ray":
        from splatwire.evaluation.study.ray_engine import RayEngine

        return RayEngine(workers)
    if name == "slurm":
        from splatwire.evaluation.study.slurm_engine import SlurmEngine

        return SlurmEngine(workers, options=slurm or SlurmOptions())
    raise UnknownNameError("engine", name, ENGINES)
