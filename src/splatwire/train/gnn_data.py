"""What the inpainting network is calibrated with: settings of a run, the scene, pseudo-losses."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from splatwire.codec.tiers import arrange_stream
from splatwire.conceal import AnchorContext, context_of
from splatwire.conceal.gnn.graph import RepairGraph, build_graph
from splatwire.conceal.gnn.quantise import check_bits
from splatwire.conceal.gnn.settings import GNN_PRESETS, GnnSettings
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, PartialScene
from splatwire.packets import PacketGroups, SceneStream
from splatwire.scene import Anchors, Cameras, Erasures
from splatwire.train.gnn_losses import LOSS_PRESETS, LossWeights


@dataclass(frozen=True)
class CalibrationConfig:
    """A calibration run.

    Attributes:
        settings: The network.
        losses: Weights of the loss terms.
        iterations: Most steps; the paper's are 15,000 to 20,000.
        learning_rate: Of Adam at the beginning; it decays to 0 with half a cosine.
        drop_rate: Share of packets that a pseudo-loss takes.
        train_masks: Pseudo-losses that are trained on; their graphs and interpolations are computed once.
        validation_masks: Pseudo-losses that are never trained on.
        batch: Queries per step.
        validation_interval: Steps between validations.
        patience: Validations without improvement after which the run ends.
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
    patience: int = 8
    bits: int = 0
    rounded_share: float = 0.3
    seed: int = 0

    def __post_init__(self) -> None:
        counts = ("iterations", "train_masks", "validation_masks", "batch", "validation_interval", "patience")
        bad = [name for name in counts if getattr(self, name) < 1]
        bad += [] if 0 < self.drop_rate < 1 else ["drop_rate"]
        bad += [] if 0 < self.learning_rate < math.inf else ["learning_rate"]
        bad += [] if self.seed >= 0 else ["seed"]
        bad += [] if 0 <= self.rounded_share <= 1 else ["rounded_share"]
        if bad:
            raise InvalidValueError(f"calibration cannot run with {', '.join(f'{n}={getattr(self, n)}' for n in bad)}")
        if self.bits:
            check_bits(self.bits)

    @property
    def rounded_from(self) -> int:
        """The step from which weights are rounded."""
        return self.iterations - round(self.rounded_share * self.iterations) if self.bits else self.iterations


CALIBRATION_PRESETS = {
    "paper": CalibrationConfig(GNN_PRESETS["paper"], LOSS_PRESETS["feature"]),
    "full": CalibrationConfig(GNN_PRESETS["full"], LOSS_PRESETS["full"]),
    "compact": CalibrationConfig(GNN_PRESETS["compact"], LOSS_PRESETS["feature"], bits=4),
}
"""`paper`: feature-focused, as reported. `full`: every attribute. `compact`: feature-focused with few weights."""


@dataclass(frozen=True, eq=False)
class CalibrationData:
    """What a sender calibrates on.

    Attributes:
        scene: The complete scene as a decoder returns it.
        context: The same for a concealer, nothing lost.
        groups: Anchors by packet.
        cameras: Views of the rendering loss; None without it.
    """

    scene: AnchorScene
    context: AnchorContext
    groups: PacketGroups
    cameras: Cameras | None = None


def calibration_data(stream: SceneStream, complete: PartialScene, cameras: Cameras | None = None) -> CalibrationData:
    """Prepares a decoded stream.

    Args:
        stream: The complete stream: it says which anchors share a packet.
        complete: What the decoder made of it.
        cameras: Views of the rendering loss.

    Raises:
        InvalidValueError: If something was lost, or there are fewer than two packets.
    """
    groups = arrange_stream(stream).groups
    if complete.erasures.num_lost:
        raise InvalidValueError("calibration needs the complete scene, and of this one packets were lost")
    if len(groups.starts) < 3:
        raise InvalidValueError("calibration needs a stream of at least two packets")
    return CalibrationData(complete.scene, context_of(complete).to_cpu(), groups, cameras)


def pseudo_loss(groups: PacketGroups, num_anchors: int, rate: float, seed: int) -> Bool[Tensor, "N"]:
    """Draws which anchors are known after a share of the packets, at least one and not all, was dropped."""
    count = len(groups.starts) - 1
    dropped = np.random.default_rng(seed).permutation(count)[: min(max(round(rate * count), 1), count - 1)]
    known = torch.ones(num_anchors, dtype=torch.bool)
    for group in dropped:
        known[torch.from_numpy(groups.ranks[groups.starts[group] : groups.starts[group + 1]])] = False
    return known


def without(context: AnchorContext, known: Bool[Tensor, "N"]) -> AnchorContext:
    """The context that a receiver has when only `known` anchors have arrived."""
    a, keep = context.anchors, known[:, None]
    anchors = Anchors(a.positions, a.features * keep, a.scalings * keep, a.offsets * keep[:, :, None], a.mask & keep)
    return replace(context, anchors=anchors, erasures=Erasures.of_anchors(known))


def pseudo_graphs(data: CalibrationData, config: CalibrationConfig) -> Iterator[RepairGraph]:
    """Graphs of the pseudo-losses of a run: first those that are trained on, then those that are held out."""
    rows = config.train_masks + config.validation_masks
    for seed in np.random.SeedSequence(config.seed).generate_state(rows).tolist():
        known = pseudo_loss(data.groups, data.context.anchors.num_anchors, config.drop_rate, seed)
        yield build_graph(without(data.context, known), config.settings)
