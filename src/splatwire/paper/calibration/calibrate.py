"""Offline calibration of the inpainting network on a single scene: Section 3.4 of the paper (`docs/paper-map.md`)."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from splatwire.calibration.pseudo_loss import CalibrationData
from splatwire.errors import InvalidValueError
from splatwire.paper.calibration.config import CalibrationConfig
from splatwire.paper.calibration.run import CalibrationResult, CalibrationRun, restore_checkpoint, save_checkpoint
from splatwire.paper.gnn.graph import RepairGraph


def calibrate(
    data: CalibrationData,
    config: CalibrationConfig,
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[int, float], None] | None = None,
    graphs: Sequence[RepairGraph] | None = None,
    device: str = "cpu",
) -> CalibrationResult:
    """Trains the inpainting network on a single scene, with simulated losses of the scene's packets (pseudo-losses).

    The network estimates the attributes of lost anchors. Source: Section 3.4 of the paper (`docs/paper-map.md`).

    Args:
        data: The complete scene and its packets.
        config: The configuration.
        checkpoint: Path of the checkpoint, written at every validation; None for no checkpoints.
        resume: True to resume from `checkpoint`, with the same configuration.
        progress: Called after every training step with the number of the step and the training loss.
        graphs: Graphs from `pseudo_graphs`; None to build them.
        device: Torch device for the training steps.

    Returns:
        The trained network, and its errors on held-out pseudo-losses.

    Raises:
        DivergedError: If the training loss is not finite.
        InvalidValueError: If a rendering loss has no cameras or is not computed on the CPU, or the checkpoint belongs
            to another scene or configuration.
        BitstreamError: If the checkpoint is damaged.
    """
    if config.losses.render and data.cameras is None:
        raise InvalidValueError("a rendering loss needs cameras")
    if config.losses.render and device != "cpu":
        raise InvalidValueError(f"a rendering loss is computed on the CPU, not on {device}")
    started = time.perf_counter()
    run = CalibrationRun(data, config, graphs, device)
    if resume and checkpoint is not None:
        restore_checkpoint(run, checkpoint)
    while not run.finished():
        loss = run.step()
        if run.iteration % config.validation_interval == 0 or run.iteration == config.iterations:
            run.keep_if_best()
            if checkpoint is not None:
                save_checkpoint(run, checkpoint)
        if progress is not None:
            progress(run.iteration, loss)
    return run.result(time.perf_counter() - started)
