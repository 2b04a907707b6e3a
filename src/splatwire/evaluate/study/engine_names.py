"""Engines by name; each is imported when it is asked for."""

from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.evaluate.study.engines import Engine, default_workers

ENGINES = ("local", "ray", "slurm")


def create_engine(name: str, workers: int | None = None) -> Engine:
    """Makes an engine.

    Args:
        name: One of `ENGINES`.
        workers: Workers at a time; None for one per processor (or for what the cluster has).

    Raises:
        UnknownNameError: If there is no such engine.
        BackendUnavailableError: If it is not installed, or cannot run here.
    """
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

        return SlurmEngine(workers)
    raise UnknownNameError("engine", name, ENGINES)
