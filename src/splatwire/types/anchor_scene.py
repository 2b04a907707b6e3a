"""Anchor scenes: anchors, the networks that draw them, and the context model that codes them."""

import warnings
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int8

from splatwire.arguments import CheckedFields, check_fields, checked
from splatwire.reprs import summary_repr
from splatwire.types.anchor_config import HacppConfig
from splatwire.types.anchors import Anchors
from splatwire.types.background import BLACK, Background, check_background
from splatwire.types.causal_coding import CausalCoding
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.networks import Mlp
from splatwire.types.origin import NO_ORIGIN, Origin, check_origin
from splatwire.types.scene import GrowStrength, RenderHints
from splatwire.types.shapes import check_hints
from splatwire.types.validity import ElementValidity, validity_of_anchors


@dataclass(frozen=True, eq=False)
class GaussianHeads(CheckedFields):
    """The three networks that compute an anchor's Gaussians for a view (as in HAC++).

    The input of each network is `[feature (F), view direction (3), view distance (1)]`. K is the number of Gaussians
    per anchor.

    Attributes:
        opacity: K outputs, then tanh; Gaussians with values of 0 and below are not drawn.
        covariance: 7 K outputs: three scale logits and a quaternion for each of the K Gaussians.
        color: 3 K outputs, then sigmoid.
    """

    opacity: Mlp
    covariance: Mlp
    color: Mlp

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class HashGrid(CheckedFields):
    """Values of the binary hash grid (HAC++): a 3D table and three tables of planes.

    The entries of all levels of a table are concatenated. D is the number of features per entry.

    Attributes:
        volume: The 3D table, values -1 or 1.
        planes: The tables of the xy, xz and yz planes, values -1 or 1.
        bounds_min: Lower corner of the box that maps to [0, 1], world units.
        bounds_max: Upper corner.
    """

    volume: Int8[Any, "rows3 D"]
    planes: Int8[Any, "3 rows2 D"]
    bounds_min: Float[Any, "3"]
    bounds_max: Float[Any, "3"]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class HacppContextModel(CheckedFields):
    """The networks and tables that predict an anchor's distribution for entropy coding (as in HAC++).

    Attributes:
        grid: The hash grid.
        prior: Network that maps the hash-grid feature (H) to `HacppConfig.prior_dim` outputs.
        channel: One network per group of feature channels. It predicts the distributions of these channels from the
            outputs of `prior` and from the groups that were decoded before.
    """

    grid: HashGrid
    prior: Mlp
    channel: tuple[Mlp, ...]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class HacppCoding(CheckedFields):
    """Networks and quantisation steps of the schema `hacpp`, unused by renderers.

    Attributes:
        context_model: The networks that predict the anchors' attributes.
        voxel_size: Spacing of anchor positions, world units; positions are integer multiples of it.
        config: Layer and table sizes of the context model, and base quantisation steps.
    """

    context_model: HacppContextModel
    voxel_size: float
    config: HacppConfig

    __repr__ = summary_repr

    @property
    def context(self) -> HacppContextModel:
        """Deprecated name of `context_model`."""
        warnings.warn("HacppCoding.context is deprecated, use context_model", DeprecationWarning, stacklevel=2)
        return self.context_model


@dataclass(frozen=True, eq=False)
class AnchorScene:
    """A scene of anchors that can be rendered and encoded.

    Attributes:
        anchors: The anchors.
        heads: The networks that compute the Gaussians of the anchors.
        coding: Parameters of the codec, specific to its schema (`hacpp` or `causal`).
        hints: Factors on size and opacity, and hidden anchors, set by loss concealment; None without concealment.
        background: RGB of the background that the scene was trained with.
        origin: World coordinates of the point that positions are relative to.
        metadata: Title, author, license, and the initial view.
    """

    ELEMENTS: ClassVar[str] = "anchors"
    """Name of the scene's elements in messages."""
    GROW_STRENGTH: ClassVar[GrowStrength] = GrowStrength(size=1.0, opacity=0.0)
    """Anchors cover surfaces, so only sizes grow until the received ones cover the surface again."""
    anchors: Anchors
    heads: GaussianHeads
    coding: HacppCoding | CausalCoding
    hints: RenderHints | None = None
    background: Background = BLACK
    origin: Origin = NO_ORIGIN
    metadata: SceneMetadata = NO_METADATA

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "background", check_background(self.background))
        object.__setattr__(self, "origin", check_origin(self.origin))
        check_fields(self)
        check_hints(self.hints, self.num_elements)

    @property
    def elements(self) -> Anchors:
        """Anchors of the scene."""
        return self.anchors

    @property
    def positions(self) -> Float[Any, "N 3"]:
        """Position of each anchor relative to the scene's origin, world units, (N, 3)."""
        return self.anchors.positions

    @property
    def num_elements(self) -> int:
        """Number of anchors, N."""
        return self.anchors.num_anchors

    def select(self, index: Any) -> "AnchorScene":
        """Returns the scene with only the anchors at `index` (integers or mask).

        Removes `hints`, the results of loss concealment.

        Raises:
            InvalidValueError: If an index is out of range, or a mask has another length.
        """
        return replace(self, anchors=self.anchors.select(index), hints=None)

    @checked
    def with_elements(self, elements: Anchors, hints: RenderHints | None = None) -> "AnchorScene":
        """Returns the scene with its anchors replaced.

        Args:
            elements: The new anchors.
            hints: Factors on size and opacity, and hidden anchors, set by loss concealment; None for no changes.
        """
        return replace(self, anchors=elements, hints=hints)

    @property
    def drawable(self) -> Bool[np.ndarray, "N"]:
        """Mask of the anchors that can be visible in at least one view.

        An encoder drops all other anchors.
        """
        return self.validity().kept

    def validity(self) -> ElementValidity:
        """Classifies the anchors as drawable, invisible or invalid; only drawable ones are encoded."""
        return validity_of_anchors(self.anchors)

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians that the anchors can produce in a view."""
        return int(self.anchors.mask.sum())

    @property
    def facts(self) -> dict[str, int | float]:
        """Scene statistics for display: number of anchors, voxel size, feature channels and offsets per anchor."""
        layout = self.coding.config.layout
        return {
            "num_anchors": self.num_elements, "voxel_size": self.coding.voxel_size,
            "feature_dim": layout.feature_dim, "num_offsets": layout.num_offsets,
        }  # fmt: skip

    @property
    def hacpp(self) -> HacppCoding:
        """Codec parameters of schema `hacpp`; only valid for a scene of that schema."""
        assert isinstance(self.coding, HacppCoding)
        return self.coding

    @property
    def causal(self) -> CausalCoding:
        """Codec parameters of schema `causal`; only valid for a scene of that schema."""
        assert isinstance(self.coding, CausalCoding)
        return self.coding
