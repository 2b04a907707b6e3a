"""A whole scene: anchors, the networks that draw them, and the context model that codes them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

from jaxtyping import Bool, Float, Int8
from torch import Tensor

from splatwire.model.causal import CausalCoding
from splatwire.model.config import ModelConfig
from splatwire.model.networks import Mlp
from splatwire.model.prior import Prior
from splatwire.scene import Anchors, Erasures
from splatwire.scene.background import BLACK, Background


@dataclass(frozen=True, eq=False)
class GaussianHeads:
    """The three networks that turn an anchor and a view into Gaussians (HACPP_SPEC 2 step 3).

    Each takes `[feature (F), view direction (3), view distance (1)]`.

    Attributes:
        opacity: K outputs, then tanh.
        covariance: 7 K outputs: three scale logits and a quaternion per offset.
        color: 3 K outputs, then sigmoid.
    """

    opacity: Mlp
    covariance: Mlp
    color: Mlp


@dataclass(frozen=True, eq=False)
class HashGrid:
    """Signs of the binary hash grid, rows of all levels one after another (HACPP_SPEC 3).

    Attributes:
        volume: The 3D table, values -1 or +1.
        planes: The tables of xy, xz and yz, values -1 or +1.
        bounds_min: Lower corner of the box that maps to [0, 1], world units.
        bounds_max: Upper corner.
    """

    volume: Int8[Tensor, "rows3 D"]
    planes: Int8[Tensor, "3 rows2 D"]
    bounds_min: Float[Tensor, "3"]
    bounds_max: Float[Tensor, "3"]


@dataclass(frozen=True, eq=False)
class ContextModel:
    """The networks and tables that predict an anchor's distribution for entropy coding.

    Attributes:
        grid: The hash grid.
        prior: Hash-grid feature (H) to `ModelConfig.prior_dim` outputs (HACPP_SPEC 4.1).
        channel: One network per feature group: the groups decoded so far and the prior's mean, scale and weight of
            all F channels to mean, scale and weight of the group (HACPP_SPEC 4.3).
    """

    grid: HashGrid
    prior: Mlp
    channel: tuple[Mlp, ...]


@dataclass(frozen=True, eq=False)
class HacppCoding:
    """What schema `hacpp` codes a scene with; nothing that draws reads it.

    Attributes:
        context: The networks that predict the anchors' attributes.
        voxel_size: Spacing of anchor positions, world units; positions are whole multiples of it.
        config: Shapes of the context model, and base quantisation steps.
    """

    context: ContextModel
    voxel_size: float
    config: ModelConfig


@dataclass(frozen=True, eq=False)
class RenderHints:
    """What helps the picture beside the attributes; never touches a decoded attribute.

    Attributes:
        size_gain: Factor on the size of the anchor's Gaussians, 1 for none.
        left_out: True where the anchor is not drawn.
        opacity_gain: Factor on the opacity of the anchor's Gaussians, which stays at most 1; None for none anywhere.
    """

    size_gain: Float[Tensor, "N"]
    left_out: Bool[Tensor, "N"]
    opacity_gain: Float[Tensor, "N"] | None = None


@dataclass(frozen=True, eq=False)
class AnchorScene:
    """A scene that can be rendered and encoded.

    Attributes:
        anchors: The anchors.
        heads: The networks that draw them.
        coding: What the codec's schema codes them with.
        hints: Render-time hints of a concealer, if one worked on the scene.
        background: RGB behind everything, in front of which the scene was trained.
    """

    ELEMENTS: ClassVar[str] = "anchors"
    """What its elements are called."""
    anchors: Anchors
    heads: GaussianHeads
    coding: HacppCoding | CausalCoding
    hints: RenderHints | None = None
    background: Background = BLACK

    @property
    def elements(self) -> Anchors:
        """Its elements."""
        return self.anchors

    @property
    def positions(self) -> Float[Tensor, "N 3"]:
        """Where its elements are."""
        return self.anchors.positions

    @property
    def num_elements(self) -> int:
        """Number of its elements, N."""
        return self.anchors.num_anchors

    def select(self, index: Tensor) -> "AnchorScene":
        """The scene with the elements at `index` (integers or a boolean mask over N), hints left out."""
        return replace(self, anchors=self.anchors.select(index), hints=None)

    @property
    def drawable(self) -> Bool[Tensor, "N"]:
        """Elements that any view can draw: those that are worth a packet."""
        return self.anchors.mask.any(dim=1)

    @property
    def num_gaussians(self) -> int:
        """Gaussians that its elements can have in a view."""
        return int(self.anchors.mask.sum())

    @property
    def hacpp(self) -> HacppCoding:
        """What schema `hacpp` codes the scene with; only for a scene that has it."""
        assert isinstance(self.coding, HacppCoding)
        return self.coding

    @property
    def causal(self) -> CausalCoding:
        """What schema `causal` codes the scene with; only for a scene that has it."""
        assert isinstance(self.coding, CausalCoding)
        return self.coding


@dataclass(frozen=True, eq=False)
class PartialScene:
    """What a decoder returns: a scene in which some anchors may lack attributes.

    Attributes:
        scene: The scene; attributes that were not received are zero (mask False).
        erasures: What was received.
        prior: The hash-grid prior of every anchor, received or not.
        concealment: Named sections of the side information, content by name: what a sender left for concealers.
        guessed: Where anchors are expected to be before their packets come, of a stream whose packets say where they
            are; lost ones stand there. None where places are known from the start.
        tier_sizes: How large the anchors of each one's tier are, relative to other tiers, above 0, received or not.
            None where the side information does not say.
    """

    scene: AnchorScene
    erasures: Erasures
    prior: Prior
    concealment: Mapping[str, bytes] = field(default_factory=dict)
    guessed: Float[Tensor, "N 3"] | None = None
    tier_sizes: Float[Tensor, "N"] | None = None

    @property
    def places(self) -> Float[Tensor, "N 3"]:
        """Where anchors are as far as the side information says: alike for lost and received ones, whatever comes."""
        return self.scene.anchors.positions if self.guessed is None else self.guessed

    def without(self, known: Bool[Tensor, "N"]) -> "PartialScene":
        """The same scene when only some anchors are there, as if the packets of the others had not come."""
        there = self.scene.anchors.arrived(known, self.guessed)
        return replace(self, scene=replace(self.scene, anchors=there), erasures=Erasures.of_anchors(known))

    def fill(self, rows: Tensor | slice, source: "PartialScene | None") -> None:
        """Copies rows of another state of the same scene into this one's tensors, in place; None takes them back."""
        for name in DECODED_ATTRIBUTES:
            getattr(self.scene.anchors, name)[rows] = 0 if source is None else getattr(source.scene.anchors, name)[rows]
        if self.guessed is not None:
            own = self.scene.anchors.positions
            own[rows] = self.guessed[rows] if source is None else source.scene.anchors.positions[rows]
        self.erasures.received[rows] = False if source is None else source.erasures.received[rows]


DECODED_ATTRIBUTES = ("features", "scalings", "offsets", "mask")
"""Fields of `Anchors` that packets bring; lost ones are zero. Of some streams packets bring places, too."""
