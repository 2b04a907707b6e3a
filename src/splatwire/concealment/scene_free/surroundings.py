"""Neighbours and expected sizes of anchors, independent of losses."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int64

from splatwire.ops.knn import NeighborTree, nearest_others
from splatwire.types import ReceivedScene

NEIGHBORS = 64
"""Number of nearest neighbours, as in the concealer `grow`, whose gain the network corrects."""
CLOSE = 32
"""Number of nearest neighbours for all features except the lost share of `Grow`; 64 takes longer without better
results."""
CLASS_NEIGHBORS = 12
CLASS_SHARES = (8, 64)
"""Size classes: the largest eighth and the largest 64th of all anchors. The hole of a lost large anchor is covered by
other large anchors around it. Its nearest neighbours are mostly small and give no information on large anchors."""
_MIN_CLASS = 8


@dataclass(frozen=True, eq=False)
class Neighborhood:
    """The k nearest neighbours of each of M anchors, and their distances.

    Attributes:
        index: For each anchor, indices in the scene of its neighbours, nearest first.
        distance: Distances to the neighbours, world units.
    """

    index: Int64[np.ndarray, "M k"]
    distance: Float[np.ndarray, "M k"]

    def first(self, count: int) -> "Neighborhood":
        """Returns a copy with only the `count` nearest neighbours of each anchor."""
        return Neighborhood(self.index[:, :count], self.distance[:, :count])


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Neighbours and expected sizes of anchors, from which the enlargement of received anchors is computed.

    None of these values depends on which anchors were lost.

    Attributes:
        log_size: Logarithm of the size of each of the scene's N anchors, as predicted from the hash grid.
        weights: Weight of each anchor when the lost share of a neighbourhood is computed.
        rows: Indices of the M anchors whose neighbours are known.
        near: Nearest neighbours of the M anchors.
        classes: Nearest large neighbours of each of the M anchors. The first item lists neighbours among the largest
            eighth of the scene's anchors, the second among the largest 64th (`CLASS_SHARES`).
    """

    log_size: Float[np.ndarray, "N"]
    weights: Float[np.ndarray, "N"]
    rows: Int64[np.ndarray, "M"]
    near: Neighborhood
    classes: tuple[Neighborhood, ...]

    def select(self, mask: Bool[np.ndarray, "M"]) -> "Surroundings":
        """Returns a copy with the neighbours of only some of the M anchors, those that `mask` selects."""

        def of(part: Neighborhood) -> Neighborhood:
            return Neighborhood(part.index[mask], part.distance[mask])

        return replace(self, rows=self.rows[mask], near=of(self.near), classes=tuple(map(of, self.classes)))


def surroundings_of(received: ReceivedScene, rows: Int64[np.ndarray, "M"]) -> Surroundings:
    """Finds the nearest neighbours and expected sizes of the anchors with indices `rows`."""
    positions, log_size = received.positions, received.log_sizes
    neighbors = Neighborhood(*nearest_others(NeighborTree(positions), positions[rows], rows, NEIGHBORS))
    by_size = np.argsort(-log_size, kind="stable")
    classes = []
    for share in CLASS_SHARES:
        members = np.sort(by_size[: max(len(by_size) // share, _MIN_CLASS)])
        index, distance = NeighborTree(positions[members]).query(positions[rows], CLASS_NEIGHBORS)
        classes.append(Neighborhood(members[index], distance))
    return Surroundings(log_size, received.sizes, rows, neighbors, tuple(classes))
