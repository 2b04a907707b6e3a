"""Offline calibration of the inpainting network on its own scene by packet-aligned pseudo-dropout (paper, 3.4)."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from splatwire.calibrate.pseudo_loss import CalibrationData
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
    """Calibrates a network on a scene.

    Args:
        data: The complete scene and its packets.
        config: The run.
        checkpoint: File that is written at every validation; None for none.
        resume: Whether to go on from it; the configuration must be the same.
        progress: Called after every step with its number and its loss.
        graphs: `pseudo_graphs` of this run, for runs that share them; None to build them.
        device: Where steps are computed; results of devices differ in their last bits.

    Returns:
        The network, and what it does on held-out losses.

    Raises:
        DivergedError: If the loss is not finite.
        InvalidValueError: If a rendering loss has no cameras or is not computed on the CPU, or the checkpoint is of
            another run.
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
            run.improve()
            if checkpoint is not None:
                save_checkpoint(run, checkpoint)
        if progress is not None:
            progress(run.iteration, loss)
    return run.result(time.perf_counter() - started)
