"""All that a concealer may see."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.model import PartialScene, PartialSplats, Prior
from splatwire.scene import AnchorLayout, Anchors, Erasures

MIN_SIZE = 1e-9
_SMALLEST = 0.05
"""Predicted sizes are kept above this share of their median: a prediction may be negative."""


@dataclass(frozen=True, eq=False)
class ElementContext:
    """What is known of elements of any kind, anchors or Gaussians; lost and received ones are measured alike.

    Attributes:
        positions: Where each element is, or is expected to be.
        log_sizes: Logarithm of the size that is expected of it.
        known: Which of them arrived.
        opacities: Of explicit Gaussians, 0 where lost; None for anchors, whose Gaussians have some of their own.
        log_scales: Logarithms of the axes of explicit Gaussians, largest first; None for anchors.
        growth: What the sender of explicit Gaussians found best (`Copies`); None where it said nothing.
        tier_sizes: See `PartialScene.tier_sizes`; None for Gaussians.
    """

    positions: Float[Tensor, "N 3"]
    log_sizes: Float[Tensor, "N"]
    known: Bool[Tensor, "N"]
    opacities: Float[Tensor, "N"] | None = None
    log_scales: Float[Tensor, "N 3"] | None = None
    growth: tuple[float, float, float] | None = None
    tier_sizes: Float[Tensor, "N"] | None = None

    @property
    def sizes(self) -> Float[Tensor, "N"]:
        """What an element counts for among its neighbours, float64: the size of its tier, or else its own."""
        return self.log_sizes.double().exp() if self.tier_sizes is None else self.tier_sizes.double()


@dataclass(frozen=True, eq=False)
class AnchorContext:
    """What arrived, where the gaps are and what the hash grid predicts; no model, no packets.

    Attributes:
        anchors: All anchors; attributes that were not received are zero (mask False).
        erasures: What was received.
        prior: The hash-grid prior of every anchor.
        layout: Sizes of an anchor.
        concealment: What the sender left for concealers in the side information, content by name.
        guessed: See `PartialScene.guessed`.
        tier_sizes: See `PartialScene.tier_sizes`.
    """

    anchors: Anchors
    erasures: Erasures
    prior: Prior
    layout: AnchorLayout
    concealment: Mapping[str, bytes] = field(default_factory=dict)
    guessed: Float[Tensor, "N 3"] | None = None
    tier_sizes: Float[Tensor, "N"] | None = None

    def __post_init__(self) -> None:
        rows = {self.anchors.num_anchors, len(self.erasures.received), len(self.prior.context)}
        if len(rows) != 1 or not self.anchors.matches(self.layout):
            raise ValueError(f"anchors, erasures, prior and layout do not fit: {sorted(rows)} rows, {self.layout}")

    @property
    def places(self) -> Float[Tensor, "N 3"]:
        """Where anchors are for the search of neighbours: lost and received ones are measured alike."""
        return self.anchors.positions if self.guessed is None else self.guessed

    @property
    def elements(self) -> ElementContext:
        """What is known of anchors as of any element."""
        known = self.erasures.known
        return ElementContext(self.places, predicted_log_size(self), known, tier_sizes=self.tier_sizes)

    def to_cpu(self) -> "AnchorContext":
        """Returns the same context in main memory, where neighbour search and kernels work."""
        prior = self.prior
        moved = {
            name: replace(part, mean=part.mean.cpu(), scale=part.scale.cpu(), step=part.step.cpu())
            for name, part in (("feature", prior.feature), ("scaling", prior.scaling), ("offset", prior.offset))
        }
        return replace(
            self,
            anchors=self.anchors.to("cpu"),
            guessed=None if self.guessed is None else self.guessed.cpu(),
            tier_sizes=None if self.tier_sizes is None else self.tier_sizes.cpu(),
            erasures=Erasures(self.erasures.received.cpu()),
            prior=replace(prior, context=prior.context.cpu(), **moved),
        )


def predicted_log_size(context: AnchorContext) -> Float[Tensor, "N"]:
    """Mean logarithm of the three sizes of an anchor's Gaussians, as the prior predicts them."""
    return mean_log_size(context.prior.scaling.mean)


def mean_log_size(scalings: Float[Tensor, "N 6"]) -> Float[Tensor, "N"]:
    """Mean logarithm of the sizes of anchors' Gaussians, given predicted scalings."""
    size = scalings[:, 3:]
    typical = float(size.clamp(min=0).median()) if len(size) else 0.0
    return size.clamp(min=max(_SMALLEST * typical, MIN_SIZE)).log().mean(dim=1)


def elements_of(partial: PartialSplats) -> ElementContext:
    """Takes from partial Gaussians what a concealer may see: the size of one is the geometric mean of its scales."""
    splats = partial.scene.splats
    axes = splats.scales.clamp(min=MIN_SIZE).log().sort(dim=1, descending=True).values
    growth = None if partial.copies is None else partial.copies.growth
    return ElementContext(splats.means, axes.mean(dim=1), partial.erasures.known, splats.opacities, axes, growth)


def context_of(partial: PartialScene) -> AnchorContext:
    """Takes from a partial scene what a concealer may see."""
    layout = partial.scene.coding.config.layout
    return AnchorContext(
        partial.scene.anchors, partial.erasures, partial.prior, layout,
        partial.concealment, partial.guessed, partial.tier_sizes,
    )  # fmt: skip
