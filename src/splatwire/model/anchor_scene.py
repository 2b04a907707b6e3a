"""A whole scene: anchors, the networks that draw them, and the context model that codes them."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int8

from splatwire.errors import check_kind
from splatwire.model.causal import CausalCoding
from splatwire.model.config import ModelConfig
from splatwire.model.networks import Mlp
from splatwire.model.scene import Coverage, RenderHints
from splatwire.reprs import summary_repr
from splatwire.scene import Anchors
from splatwire.scene.background import BLACK, Background, check_background
from splatwire.scene.metadata import NO_METADATA, SceneMetadata
from splatwire.scene.rows import Rows, rows_of_anchors


@dataclass(frozen=True, eq=False)
class GaussianHeads:
    """The three networks that turn an anchor and a view into Gaussians (HAC++, decoding of a view).

    Each takes `[feature (F), view direction (3), view distance (1)]`.

    Attributes:
        opacity: K outputs, then tanh.
        covariance: 7 K outputs: three scale logits and a quaternion per offset.
        color: 3 K outputs, then sigmoid.
    """

    opacity: Mlp
    covariance: Mlp
    color: Mlp

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class HashGrid:
    """Signs of the binary hash grid, rows of all levels one after another (HAC++, hash grid).

    Attributes:
        volume: The 3D table, values -1 or +1.
        planes: The tables of xy, xz and yz, values -1 or +1.
        bounds_min: Lower corner of the box that maps to [0, 1], world units.
        bounds_max: Upper corner.
    """

    volume: Int8[Any, "rows3 D"]
    planes: Int8[Any, "3 rows2 D"]
    bounds_min: Float[Any, "3"]
    bounds_max: Float[Any, "3"]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class ContextModel:
    """The networks and tables that predict an anchor's distribution for entropy coding.

    Attributes:
        grid: The hash grid.
        prior: Hash-grid feature (H) to `ModelConfig.prior_dim` outputs (HAC++, prior network).
        channel: One network per feature group: the groups decoded so far and the prior's mean, scale and weight of
            all F channels to mean, scale and weight of the group (HAC++, channel context).
    """

    grid: HashGrid
    prior: Mlp
    channel: tuple[Mlp, ...]

    __repr__ = summary_repr


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

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class AnchorScene:
    """A scene that can be rendered and encoded.

    Attributes:
        anchors: The anchors.
        heads: The networks that draw them.
        coding: What the codec's schema codes them with.
        hints: Render-time hints of a concealer, if one worked on the scene.
        background: RGB behind everything, in front of which the scene was trained.
        metadata: Title, author, license, and how the scene is looked at first.
    """

    ELEMENTS: ClassVar[str] = "anchors"
    """What its elements are called."""
    COVERAGE: ClassVar[Coverage] = Coverage(size=1.0, opacity=0.0)
    """Anchors cover surfaces: what is left grows until it covers them again."""
    anchors: Anchors
    heads: GaussianHeads
    coding: HacppCoding | CausalCoding
    hints: RenderHints | None = None
    background: Background = BLACK
    metadata: SceneMetadata = NO_METADATA

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        check_kind(self.anchors, Anchors, "open_scene")
        object.__setattr__(self, "background", check_background(self.background))

    @property
    def elements(self) -> Anchors:
        """Its elements."""
        return self.anchors

    @property
    def positions(self) -> Float[Any, "N 3"]:
        """Where its elements are."""
        return self.anchors.positions

    @property
    def num_elements(self) -> int:
        """Number of its elements, N."""
        return self.anchors.num_anchors

    def select(self, index: Any) -> "AnchorScene":
        """The scene with the elements at `index` (integers or a boolean mask over N), hints left out."""
        return replace(self, anchors=self.anchors.select(index), hints=None)

    def with_elements(self, elements: Anchors, hints: RenderHints | None = None) -> "AnchorScene":
        """The scene with other anchors and hints."""
        return replace(self, anchors=elements, hints=hints)

    @property
    def drawable(self) -> Bool[np.ndarray, "N"]:
        """Elements that any view can draw: those that are worth a packet."""
        return self.rows().kept

    def rows(self) -> Rows:
        """What becomes of its elements where the scene is coded."""
        return rows_of_anchors(self.anchors)

    @property
    def num_gaussians(self) -> int:
        """Gaussians that its elements can have in a view."""
        return int(self.anchors.mask.sum())

    @property
    def facts(self) -> dict[str, int | float]:
        """Its sizes."""
        layout = self.coding.config.layout
        return {
            "num_anchors": self.num_elements, "voxel_size": self.coding.voxel_size,
            "feature_dim": layout.feature_dim, "num_offsets": layout.num_offsets,
        }  # fmt: skip

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
