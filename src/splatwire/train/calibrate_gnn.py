"""Offline calibration of the inpainting network on its own scene by packet-aligned pseudo-dropout (paper, 3.4)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from splatwire.conceal.gnn.graph import RepairGraph
from splatwire.errors import InvalidValueError
from splatwire.train.gnn_data import CALIBRATION_PRESETS as CALIBRATION_PRESETS
from splatwire.train.gnn_data import CalibrationConfig as CalibrationConfig
from splatwire.train.gnn_data import CalibrationData as CalibrationData
from splatwire.train.gnn_data import calibration_data as calibration_data
from splatwire.train.gnn_data import pseudo_graphs as pseudo_graphs
from splatwire.train.gnn_data import pseudo_loss as pseudo_loss
from splatwire.train.gnn_data import without as without
from splatwire.train.gnn_run import CalibrationResult as CalibrationResult
from splatwire.train.gnn_run import CalibrationRun, restore_checkpoint, save_checkpoint


@dataclass(frozen=True)
class CalibrationProgress:
    """How far a run is. `errors` and `reference` are of the last validation: this network's and the interpolation's."""

    iteration: int
    iterations: int
    loss: float
    errors: dict[str, float]
    reference: dict[str, float]


def calibrate(
    data: CalibrationData,
    config: CalibrationConfig,
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[CalibrationProgress], None] | None = None,
    graphs: Sequence[RepairGraph] | None = None,
) -> CalibrationResult:
    """Calibrates a network on a scene.

    Args:
        data: The complete scene and its packets.
        config: The run.
        checkpoint: File that is written at every validation; None for none.
        resume: Whether to go on from it; the configuration must be the same.
        progress: Called after every step.
        graphs: `pseudo_graphs` of this run, for runs that share them; None to build them.

    Returns:
        The network that was best on held-out losses.

    Raises:
        DivergedError: If the loss is not finite.
        InvalidValueError: If a rendering loss has no cameras, or the checkpoint is of another run.
        BitstreamError: If the checkpoint is damaged.
    """
    if config.losses.render and data.cameras is None:
        raise InvalidValueError("a rendering loss needs cameras")
    started = time.perf_counter()
    run = CalibrationRun(data, config, graphs)
    if resume and checkpoint is not None:
        restore_checkpoint(run, checkpoint)
    errors = run.best_errors
    while not run.finished():
        loss = run.step()
        if run.iteration % config.validation_interval == 0 or run.iteration == config.iterations:
            errors = run.improve()
            if checkpoint is not None:
                save_checkpoint(run, checkpoint)
        if progress is not None:
            progress(CalibrationProgress(run.iteration, config.iterations, loss, errors, run.reference))
    return run.result(time.perf_counter() - started)
