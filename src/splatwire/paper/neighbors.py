"""Nearest-neighbour search for torch tensors."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.ops.knn import NeighborTree, nearest_others


class TensorTree:
    """Search tree for the points nearest to queries by Euclidean distance, as torch tensors.

    Args:
        support: Positions of the points.
    """

    def __init__(self, support: Float[Tensor, "S 3"]) -> None:
        self.tree = NeighborTree(support)

    def query(self, queries: Float[Tensor, "Q 3"], k: int) -> tuple[Int64[Tensor, "Q kept"], Float[Tensor, "Q kept"]]:
        """Finds the `k` points nearest to each query, or all points if there are fewer.

        Returns:
            Indices and distances of these points, nearest first.
        """
        index, distance = self.tree.query(queries, k)
        return torch.from_numpy(index).to(queries.device), torch.from_numpy(distance).to(queries.device)


def nearest_other_points(
    tree: TensorTree, points: Float[Tensor, "Q 3"], own_indices: Int64[Tensor, "Q"], k: int
) -> tuple[Int64[Tensor, "Q kept"], Float[Tensor, "Q kept"]]:
    """Finds, for some points of a search tree, the nearest other points of the tree.

    Args:
        tree: The search tree.
        points: Positions of the query points.
        own_indices: Index of each query point in the tree; this point is excluded from the neighbours.
        k: Maximum number of neighbours.

    Returns:
        Indices of the neighbours in the tree, nearest first, and their distances.
    """
    index, distance = nearest_others(tree.tree, points, own_indices, k)
    return torch.from_numpy(index).to(points.device), torch.from_numpy(distance).to(points.device)
