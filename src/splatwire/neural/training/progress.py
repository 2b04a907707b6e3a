"""Progress reports of a training."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import torch

from splatwire.arguments import CheckedFields
from splatwire.neural.training.grid import sign_bits
from splatwire.neural.training.quality import QualityReport
from splatwire.neural.training.rate import binary_entropy_bits
from splatwire.neural.training.state import TrainState
from splatwire.neural.training.step import StepReport
from splatwire.types import AnchorScene

_MEAN_DECAY = 0.98
"""Weight of the previous value in the running means (exponential moving average)."""
_MAX_DURATIONS, _MIN_DURATIONS = 50, 10
"""Maximum and minimum number of last iterations whose median duration determines the speed."""
_POSITION_BITS = 11
"""Approximate bits of an anchor's position; only for the HAC++ model, whose bits per anchor exclude positions."""
_WEIGHT_BITS = 6
"""Approximate bits of a network weight in the side information."""


@dataclass(frozen=True)
class Progress:
    """Progress of a training after an iteration.

    Attributes:
        iteration: Number of completed iterations.
        iterations: Total number of iterations.
        loss: Running mean of the loss.
        l1: Running mean of the mean absolute error of rendered pictures.
        num_elements: Number of anchors or Gaussians.
        estimated_bytes: Estimated size of the encoded scene; None until the loss includes the bit rate.
        seconds: Duration of all iterations since the training was started or resumed, seconds.
        iterations_per_second: Speed, from the median duration of the last iterations; None if unknown.
        elements: Name of the elements in messages.
    """

    iteration: int
    iterations: int
    loss: float
    l1: float
    num_elements: int
    estimated_bytes: int | None
    seconds: float
    iterations_per_second: float | None
    elements: str = AnchorScene.ELEMENTS


_NETWORKS = ("heads", "prior", "channel", "causal")


@dataclass(frozen=True)
class Listener(CheckedFields):
    """Callbacks of a training.

    Attributes:
        progress: Called after every iteration with the progress.
        tested: Called after every test with the quality of the test views.
        should_stop: Called after every iteration; True ends the training with a checkpoint.
        final_task: Called with the completed share, 0 to 1, of the task that follows the last iteration. The task is
            the refinement of the context model or, for explicit Gaussians, the fine-tuning with rounding.
        iterated: Called after every iteration with a function that returns the present scene, on the CPU.
    """

    progress: Callable[[Progress], None] = lambda progress: None
    tested: Callable[[QualityReport], None] = lambda report: None
    should_stop: Callable[[], bool] = lambda: False
    final_task: Callable[[float], None] = lambda share: None
    iterated: Callable[[Callable[[], Any]], None] = lambda scene: None


@dataclass
class RunningMeans:
    """Running means of the loss, the error and the bits of training iterations, for progress reports.

    Attributes:
        iterations: Number of iterations of the training.
        interval: Number of iterations between two updates of the means.
        estimate: Function that estimates the bytes of the scene from the state and the bits per element; None if
            unavailable.
        elements: Name of the elements in messages.
        means: The running means by name.
        durations: Durations of the last iterations, seconds.
        unread_reports: Reports of the iterations since the last update.
        estimated_size: Estimated bytes of the encoded scene; None until the loss includes the bit rate.
    """

    iterations: int
    interval: int = 1
    estimate: Callable[[Any, float], int] | None = None
    elements: str = AnchorScene.ELEMENTS
    means: dict[str, float] = field(default_factory=dict)
    durations: deque[float] = field(default_factory=lambda: deque(maxlen=_MAX_DURATIONS))
    unread_reports: list[StepReport] = field(default_factory=list)
    estimated_size: int | None = None

    def update(self, state: Any, report: StepReport, elapsed: float, seconds: float) -> Progress:
        """Adds the report of an iteration; returns the progress of the training.

        Args:
            state: State after the iteration.
            report: Result of the iteration.
            elapsed: Duration of the iteration, seconds.
            seconds: Duration of all iterations since the training was started or resumed, seconds.
        """
        self.unread_reports.append(report)
        if not self.means or state.iteration % self.interval == 0 or state.iteration == self.iterations:
            self._read_reports(state)
        means = self.means
        self.durations.append(elapsed)
        enough = len(self.durations) >= _MIN_DURATIONS
        return Progress(
            iteration=state.iteration,
            iterations=self.iterations,
            loss=means["loss"],
            l1=means["l1"],
            num_elements=state.num_elements,
            estimated_bytes=self.estimated_size,
            seconds=seconds,
            iterations_per_second=1 / max(median(self.durations), 1e-9) if enough else None,
            elements=self.elements,
        )

    def _read_reports(self, state: Any) -> None:
        """Adds all new reports of training iterations to the running means."""
        # The reports are copied from the device at once, because each copy waits for the device.
        columns = torch.stack([
            torch.stack([r.total, r.absolute_error, r.total if r.sample_bits is None else r.sample_bits]).double()
            for r in self.unread_reports
        ]).cpu().tolist()  # fmt: skip
        means = self.means
        for report, (loss, l1, bits) in zip(self.unread_reports, columns, strict=True):
            losses = {"loss": loss, "l1": l1}
            if report.sample_bits is not None:
                losses["bits"] = bits / max(report.num_sampled, 1)
            for name, value in losses.items():
                means[name] = _MEAN_DECAY * means.get(name, value) + (1 - _MEAN_DECAY) * value
        last, self.unread_reports = self.unread_reports[-1], []
        self.estimated_size = None
        if self.estimate is not None and last.sample_bits is not None:
            self.estimated_size = self.estimate(state, means["bits"])


@torch.no_grad()
def estimate_bytes(state: TrainState, bits_per_anchor: float, mask_threshold: float) -> int:
    """Estimates the bytes of the encoded scene.

    Args:
        state: State of the training.
        bits_per_anchor: Running mean of the estimated bits per anchor (`StepReport.bits_per_anchor`).
        mask_threshold: An offset exists if the sigmoid of its mask logit is above this value.
    """
    parameters = state.parameters
    num_weights = sum(v.numel() for name, v in parameters.items() if name.split(".")[0] in _NETWORKS)
    total = state.num_anchors * bits_per_anchor + num_weights * _WEIGHT_BITS
    if "grid.volume" in parameters:  # HAC++: the bits per anchor exclude positions and masks
        mask = state.masks(mask_threshold)
        alive = mask.any(dim=1)
        total += int(alive.sum()) * _POSITION_BITS
        total += float(sign_bits(parameters["grid.volume"], parameters["grid.planes"]))
        total += binary_entropy_bits(float(mask[alive].sum()), mask[alive].numel())
    return round(total / 8)
