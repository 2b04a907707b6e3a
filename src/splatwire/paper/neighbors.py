"""Nearest neighbours of torch tensors."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.ops.knn import NeighborTree, nearest_others


class TensorTree:
    """Points prepared for neighbour queries; see `splatwire.ops.knn.NeighborTree`.

    Args:
        support: The points.
    """

    def __init__(self, support: Float[Tensor, "S 3"]) -> None:
        self.tree = NeighborTree(support)

    def query(self, queries: Float[Tensor, "Q 3"], k: int) -> tuple[Int64[Tensor, "Q kept"], Float[Tensor, "Q kept"]]:
        """Finds the `min(k, S)` points nearest to each query, nearest first; returns indices and distances."""
        index, distance = self.tree.query(queries, k)
        return torch.from_numpy(index).to(queries.device), torch.from_numpy(distance).to(queries.device)


def nearest_other_points(
    tree: TensorTree, points: Float[Tensor, "Q 3"], own: Int64[Tensor, "Q"], k: int
) -> tuple[Int64[Tensor, "Q kept"], Float[Tensor, "Q kept"]]:
    """Finds the nearest neighbours of points of the tree without themselves; see `splatwire.ops.knn.nearest_others`."""
    index, distance = nearest_others(tree.tree, points, own, k)
    return torch.from_numpy(index).to(points.device), torch.from_numpy(distance).to(points.device)
