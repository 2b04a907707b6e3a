"""Settings of a calibration of the inpainting network."""

import math
from dataclasses import dataclass, field

from splatwire.calibrate.checks import check_settings
from splatwire.paper.calibration.losses import LOSS_PRESETS, LossWeights
from splatwire.paper.gnn.quantise import check_bits
from splatwire.paper.gnn.settings import GNN_PRESETS, GnnSettings


@dataclass(frozen=True)
class CalibrationConfig:
    """A calibration run.

    Attributes:
        settings: The network.
        losses: Weights of the loss terms.
        iterations: Steps; the most, where held-out losses may end the run.
        learning_rate: Of Adam at the beginning; it decays to 0 with half a cosine.
        drop_rate: Share of packets that a pseudo-loss takes.
        train_masks: Pseudo-losses that are trained on; their graphs and interpolations are computed once.
        validation_masks: Pseudo-losses that are never trained on.
        batch: Queries per step.
        validation_interval: Steps between validations.
        selected: Whether held-out losses decide what comes out: the run ends after `patience`, its best network is
            kept, and an attribute that is no better than the interpolation gets a threshold of 1.01. The paper has none
            of these rules: its preset keeps the last network of the whole schedule, and its thresholds.
        patience: Validations without improvement after which a selected run ends.
        bits: Bits per weight, about, for weights that travel in the stream (2 to 6): the last steps are taken with
            rounded weights, and what comes out is what a receiver reads. 0 for exact weights.
        rounded_share: Share of the steps that are taken so.
        seed: Seed of everything random.
    """

    settings: GnnSettings = field(default_factory=GnnSettings)
    losses: LossWeights = field(default_factory=LossWeights)
    iterations: int = 2000
    learning_rate: float = 1e-3
    drop_rate: float = 0.2
    train_masks: int = 12
    validation_masks: int = 3
    batch: int = 512
    validation_interval: int = 100
    selected: bool = True
    patience: int = 8
    bits: int = 0
    rounded_share: float = 0.3
    seed: int = 0

    def __post_init__(self) -> None:
        check_settings(
            self, "a calibration",
            ("iterations", "train_masks", "validation_masks", "batch", "validation_interval", "patience"),
            drop_rate=0 < self.drop_rate < 1, learning_rate=0 < self.learning_rate < math.inf, seed=self.seed >= 0,
            rounded_share=0 <= self.rounded_share <= 1,
        )  # fmt: skip
        if self.bits:
            check_bits(self.bits)

    @property
    def rounded_from(self) -> int:
        """The step from which weights are rounded."""
        return self.iterations - round(self.rounded_share * self.iterations) if self.bits else self.iterations


CALIBRATION_PRESETS = {
    "paper": CalibrationConfig(GNN_PRESETS["paper"], LOSS_PRESETS["feature"], iterations=15_000, selected=False),
    "full": CalibrationConfig(GNN_PRESETS["full"], LOSS_PRESETS["full"]),
    "compact": CalibrationConfig(GNN_PRESETS["compact"], LOSS_PRESETS["feature"], bits=4),
}
"""`paper`: feature-focused, with the schedule and the rules that are reported. `full`: every attribute. `compact`:
feature-focused with few weights."""
