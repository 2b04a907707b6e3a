"""Configuration of the HAC++ context model: hash-grid resolutions, table sizes, base quantisation steps."""

from dataclasses import dataclass, field

from splatwire.arguments import CheckedFields
from splatwire.types.attributes import AnchorLayout

RESOLUTIONS_3D = (18, 24, 33, 44, 59, 80, 108, 148, 201, 275, 376, 514)
RESOLUTIONS_2D = (130, 258, 514, 1026)
PLANES = ((0, 1), (0, 2), (1, 2))
"""Axes of the three planes: xy, xz, yz."""


@dataclass(frozen=True)
class HashGridConfig(CheckedFields):
    """Configuration of the binary hash grid, which consists of one 3D table and three plane tables (HAC++).

    Attributes:
        features_per_level: Number of feature values per hash-table entry.
        resolutions_3d: Grid resolution of each level of the 3D table.
        resolutions_2d: Grid resolution of each level of each plane.
        log2_rows_3d: log2 of the maximum number of hash-table entries of a level of the 3D grid.
        log2_rows_2d: log2 of the maximum number of hash-table entries of a level of a plane.
    """

    features_per_level: int = 4
    resolutions_3d: tuple[int, ...] = RESOLUTIONS_3D
    resolutions_2d: tuple[int, ...] = RESOLUTIONS_2D
    log2_rows_3d: int = 13
    log2_rows_2d: int = 15

    @property
    def context_dim(self) -> int:
        """Length H of the feature vector that the hash grid gives for a position."""
        return self.features_per_level * (len(self.resolutions_3d) + len(PLANES) * len(self.resolutions_2d))

    def rows(self, dims: int) -> tuple[int, ...]:
        """Number of hash-table entries of each level of the grid with `dims` (3 or 2) coordinates."""
        resolutions, log2 = (
            (self.resolutions_3d, self.log2_rows_3d) if dims == 3 else (self.resolutions_2d, self.log2_rows_2d)
        )
        # capped, and rounded up to a multiple of 8
        return tuple(-(-min(1 << log2, r**dims) // 8) * 8 for r in resolutions)


@dataclass(frozen=True)
class HacppConfig(CheckedFields):
    """Parameters that determine the tensor shapes of a scene's HAC++ model.

    Attributes:
        layout: Number of feature channels and offsets per anchor.
        grid: Resolutions and table sizes of the hash grid.
        base_steps: Quantisation steps of feature, scaling and offset; the context model multiplies them by factors.
    """

    layout: AnchorLayout = field(default_factory=AnchorLayout)
    grid: HashGridConfig = field(default_factory=HashGridConfig)
    base_steps: tuple[float, float, float] = (1.0, 0.001, 0.2)

    @property
    def context_dim(self) -> int:
        """Length H of the hash-grid feature at a position."""
        return self.grid.context_dim

    @property
    def prior_dim(self) -> int:
        """Number of outputs of the prior network, which predicts the distributions of an anchor's attributes."""
        return 3 * self.layout.feature_dim + 2 * 6 + 2 * 3 * self.layout.num_offsets + 3
