"""Who is near whom, and how large every anchor is expected to be: what does not depend on which packets were lost."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int64

from splatwire.model import Partial
from splatwire.ops.knn import NeighborTree, nearest_others

NEIGHBORS = 64
"""As many as `grow` counts losses among, since its gain is where the network starts."""
CLOSE = 32
"""Of these, how many the other entries of a signature look at: twice as many cost time and tell no more."""
CLASS_NEIGHBORS = 12
CLASS_SHARES = (8, 64)
"""Size classes: the largest eighth and the largest 64th. What covers a hole that a large anchor left is the other large
anchors around it, of which the nearest neighbours, small and many, say nothing."""
_MIN_CLASS = 8


@dataclass(frozen=True, eq=False)
class Neighborhood:
    """Anchors near M anchors.

    Attributes:
        index: Anchors, nearest first; fewer than k where there are no more.
        distance: Their distances, world units.
    """

    index: Int64[np.ndarray, "M k"]
    distance: Float[np.ndarray, "M k"]

    def first(self, count: int) -> "Neighborhood":
        """Returns the nearest of them."""
        return Neighborhood(self.index[:, :count], self.distance[:, :count])


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Neighbourhoods of some of N anchors; the neighbours may be received or lost.

    Attributes:
        log_size: Logarithm of the size that the prior predicts, of all anchors. Lost and received anchors are measured
            alike, so that the difference between prediction and truth does not look like a loss.
        weights: What each anchor counts for in the growth that the network corrects (`Partial.sizes`).
        rows: The anchors whose surroundings these are.
        near: Their nearest other anchors.
        classes: The nearest members of each size class.
    """

    log_size: Float[np.ndarray, "N"]
    weights: Float[np.ndarray, "N"]
    rows: Int64[np.ndarray, "M"]
    near: Neighborhood
    classes: tuple[Neighborhood, ...]

    def select(self, wanted: Bool[np.ndarray, "M"]) -> "Surroundings":
        """Returns the surroundings of some of the anchors."""

        def of(part: Neighborhood) -> Neighborhood:
            return Neighborhood(part.index[wanted], part.distance[wanted])

        return replace(self, rows=self.rows[wanted], near=of(self.near), classes=tuple(map(of, self.classes)))


def surroundings_of(partial: Partial, rows: Int64[np.ndarray, "M"]) -> Surroundings:
    """Finds the neighbours of some anchors."""
    positions, log_size = partial.places, partial.log_sizes
    near = Neighborhood(*nearest_others(NeighborTree(positions), positions[rows], rows, NEIGHBORS))
    by_size = np.argsort(-log_size, kind="stable")
    classes = []
    for share in CLASS_SHARES:
        members = np.sort(by_size[: max(len(by_size) // share, _MIN_CLASS)])
        index, distance = NeighborTree(positions[members]).query(positions[rows], CLASS_NEIGHBORS)
        classes.append(Neighborhood(members[index], distance))
    return Surroundings(log_size, partial.sizes, rows, near, tuple(classes))
