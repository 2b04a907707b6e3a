"""Settings of a calibration of the inpainting network."""

import math
from dataclasses import dataclass, field

from splatwire.calibration.checks import check_settings
from splatwire.paper.calibration.losses import LOSS_PRESETS, LossWeights
from splatwire.paper.gnn.quantise import check_bits
from splatwire.paper.gnn.settings import GNN_PRESETS, GnnSettings


@dataclass(frozen=True)
class CalibrationConfig:
    """Configuration of a calibration, that is, of the training of the inpainting network on one scene.

    Attributes:
        settings: Settings of the network.
        losses: Weights of the terms of the training loss.
        iterations: Number of training steps; with `selected`, the training may end earlier.
        learning_rate: Initial learning rate of Adam; it decays to 0 along half a cosine.
        drop_rate: Share of the packets that a pseudo-loss (simulated packet loss) drops.
        train_masks: Number of pseudo-losses for training.
        validation_masks: Number of held-out pseudo-losses for validation.
        batch: Number of lost anchors (queries) per training step.
        validation_interval: Number of training steps between validations.
        selected: True to return the network with the smallest errors on held-out pseudo-losses. The network is then not
            used for attributes that the interpolation predicts at least as well.
        patience: With `selected`, number of validations without improvement after which the training ends.
        bits: Approximate bits per weight in the stream, 2 to 6; 0 for exact weights.
        rounded_share: Share of the training steps with quantised weights, 0 to 1.
        seed: Seed of all random numbers.
    """

    # With `selected`, training ends after `patience` validations without improvement. A threshold of 1.01 disables
    # an attribute. The paper has none of these rules; the preset `paper` returns the last network, with unchanged
    # thresholds. With `bits`, the last training steps use quantised weights, and the result is exactly the network
    # that a receiver reads.

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
        """Number of the first training step with quantised weights; `iterations` if there is none."""
        return self.iterations - round(self.rounded_share * self.iterations) if self.bits else self.iterations


CALIBRATION_PRESETS = {
    "paper": CalibrationConfig(GNN_PRESETS["paper"], LOSS_PRESETS["feature"], iterations=15_000, selected=False),
    "full": CalibrationConfig(GNN_PRESETS["full"], LOSS_PRESETS["full"]),
    "compact": CalibrationConfig(GNN_PRESETS["compact"], LOSS_PRESETS["feature"], bits=4),
}
"""Named configurations. `paper`: trains mainly the features, with the published schedule. `full`: trains every
attribute. `compact`: trains mainly the features, in a small network."""
