"""Shape of the context model: hash-grid resolutions, table sizes, base quantisation steps."""

from dataclasses import dataclass, field

from splatwire.scene import AnchorLayout

RESOLUTIONS_3D = (18, 24, 33, 44, 59, 80, 108, 148, 201, 275, 376, 514)
RESOLUTIONS_2D = (130, 258, 514, 1026)
PLANES = ((0, 1), (0, 2), (1, 2))
"""Axes of the three planes: xy, xz, yz."""


@dataclass(frozen=True)
class HashGridConfig:
    """Binary hash grid: one 3D table and three planes (HAC++, hash grid).

    Attributes:
        features_per_level: Values per table row.
        resolutions_3d: Grid resolution of each level of the 3D table.
        resolutions_2d: Grid resolution of each level of each plane.
        log2_rows_3d: Cap on the rows of a 3D level, log2.
        log2_rows_2d: Cap on the rows of a plane level, log2.
    """

    features_per_level: int = 4
    resolutions_3d: tuple[int, ...] = RESOLUTIONS_3D
    resolutions_2d: tuple[int, ...] = RESOLUTIONS_2D
    log2_rows_3d: int = 13
    log2_rows_2d: int = 15

    @property
    def context_dim(self) -> int:
        """Length of the interpolated feature, H."""
        return self.features_per_level * (len(self.resolutions_3d) + len(PLANES) * len(self.resolutions_2d))

    def rows(self, dims: int) -> tuple[int, ...]:
        """Rows of each level of the table with `dims` (3 or 2) coordinates: capped, rounded up to a multiple of 8."""
        resolutions, log2 = (
            (self.resolutions_3d, self.log2_rows_3d) if dims == 3 else (self.resolutions_2d, self.log2_rows_2d)
        )
        return tuple(-(-min(1 << log2, r**dims) // 8) * 8 for r in resolutions)


@dataclass(frozen=True)
class ModelConfig:
    """Everything that fixes the tensor shapes of a scene's model.

    Attributes:
        layout: Sizes of an anchor.
        grid: Shape of the hash grid.
        base_steps: Quantisation steps of feature, scaling and offset before adaptation (HAC++, adaptive steps).
    """

    layout: AnchorLayout = field(default_factory=AnchorLayout)
    grid: HashGridConfig = field(default_factory=HashGridConfig)
    base_steps: tuple[float, float, float] = (1.0, 0.001, 0.2)

    @property
    def context_dim(self) -> int:
        """Numbers that describe a place: the hash grid's feature."""
        return self.grid.context_dim

    @property
    def prior_dim(self) -> int:
        """Outputs of the prior network: mean, scale, weight of features; mean, scale of the rest; three steps."""
        return 3 * self.layout.feature_dim + 2 * 6 + 2 * 3 * self.layout.num_offsets + 3
