"""What a run tells on its way, and whom."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median

import torch

from splatwire.entropy.rate import binary_entropy_bits
from splatwire.train.config import TrainConfig
from splatwire.train.grid import sign_bits
from splatwire.train.quality import QualityReport
from splatwire.train.state import TrainState
from splatwire.train.step import StepReport

_MEMORY = 0.98
"""Share of the past in the running means that are shown."""
_RECENT, _FEWEST = 50, 10
"""Iterations whose median is the speed, and how many there must be."""
_POSITION_BITS = 11
_WEIGHT_BITS = 6
"""About what the codec needs for an anchor's position and for a weight; only for the estimate on the way."""


@dataclass(frozen=True)
class Progress:
    """How a run is doing.

    Attributes:
        iteration: Iterations done.
        iterations: Iterations in all.
        loss: Running mean of the loss.
        l1: Running mean of the pictures' absolute error.
        num_anchors: Anchors.
        estimated_bytes: Estimated size of the encoded scene; None before the context phase.
        seconds: Since this part of the run began.
        iterations_per_second: By the median of the last iterations, so that one in which kernels were compiled does not
            count; None before there are enough.
    """

    iteration: int
    iterations: int
    loss: float
    l1: float
    num_anchors: int
    estimated_bytes: int | None
    seconds: float
    iterations_per_second: float | None


_NETWORKS = ("heads", "prior", "channel", "causal")


@dataclass(frozen=True)
class Listener:
    """What to call during a run.

    Attributes:
        progress: After every iteration.
        tested: After test views were drawn.
        should_stop: Asked after every iteration; True ends the run with a checkpoint.
        refining: While the context model is fitted again at the end; the share that is done.
    """

    progress: Callable[[Progress], None] = lambda progress: None
    tested: Callable[[QualityReport], None] = lambda report: None
    should_stop: Callable[[], bool] = lambda: False
    refining: Callable[[float], None] = lambda share: None


@dataclass
class RunningMeans:
    """Running means of what the iterations of a run found.

    Attributes:
        config: The recipe.
        interval: Iterations between two readings of reports; in between the last means stand.
        means: By name.
        recent: Seconds of the last iterations.
        unread: Reports since the last reading.
        size: Estimated bytes at the last reading; None before the context phase.
    """

    config: TrainConfig
    interval: int = 1
    means: dict[str, float] = field(default_factory=dict)
    recent: deque[float] = field(default_factory=lambda: deque(maxlen=_RECENT))
    unread: list[StepReport] = field(default_factory=list)
    size: int | None = None

    def after(self, state: TrainState, report: StepReport, elapsed: float, seconds: float) -> Progress:
        """Returns how a run is doing, whose last iteration took `elapsed` and all that were its part `seconds`."""
        self.unread.append(report)
        if not self.means or state.iteration % self.interval == 0 or state.iteration == self.config.marks.iterations:
            self._read(state)
        means = self.means
        self.recent.append(elapsed)
        told = len(self.recent) >= _FEWEST
        return Progress(
            iteration=state.iteration,
            iterations=self.config.marks.iterations,
            loss=means["loss"],
            l1=means["l1"],
            num_anchors=state.num_anchors,
            estimated_bytes=self.size,
            seconds=seconds,
            iterations_per_second=1 / max(median(self.recent), 1e-9) if told else None,
        )

    def _read(self, state: TrainState) -> None:
        """Reads all reports in one copy from the device."""
        columns = torch.stack([
            torch.stack([r.total, r.absolute_error, r.total if r.sample_bits is None else r.sample_bits]).double()
            for r in self.unread
        ]).cpu().tolist()  # fmt: skip
        means = self.means
        for report, (loss, l1, bits) in zip(self.unread, columns, strict=True):
            found = {"loss": loss, "l1": l1}
            if report.sample_bits is not None:
                found["bits"] = bits / max(report.num_sampled, 1)
            for name, value in found.items():
                means[name] = _MEMORY * means.get(name, value) + (1 - _MEMORY) * value
        last, self.unread = self.unread[-1], []
        threshold = self.config.mask_threshold
        self.size = None if last.sample_bits is None else estimate_bytes(state, means["bits"], threshold)


@torch.no_grad()
def estimate_bytes(state: TrainState, bits_per_anchor: float, mask_threshold: float) -> int:
    """Estimates what the codec will make of a state, from the running mean of its anchors' bits."""
    parameters = state.parameters
    mask = state.masks(mask_threshold)
    alive = mask.any(dim=1)
    kept = int(alive.sum())
    weights = sum(v.numel() for name, v in parameters.items() if name.split(".")[0] in _NETWORKS)
    total = state.num_anchors * bits_per_anchor + kept * _POSITION_BITS + weights * _WEIGHT_BITS
    if "grid.volume" in parameters:
        total += float(sign_bits(parameters["grid.volume"], parameters["grid.planes"]))
        total += binary_entropy_bits(float(mask[alive].sum()), mask[alive].numel())
    return round(total / 8)
