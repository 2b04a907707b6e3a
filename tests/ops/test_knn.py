import numpy as np
import pytest
import torch

from splatwire.ops.knn import NeighborTree, nearest_neighbors, nearest_others


def brute_force(support: torch.Tensor, queries: torch.Tensor, k: int) -> tuple[np.ndarray, np.ndarray]:
    distance = np.linalg.norm(queries.double().numpy()[:, None] - support.double().numpy()[None], axis=2)
    order = np.argsort(distance, axis=1, kind="stable")[:, :k]
    return order, np.take_along_axis(distance, order, axis=1)


@pytest.mark.parametrize(("num_points", "k"), [(500, 1), (500, 8), (500, 128), (5, 8), (1, 3), (0, 3)])
def test_agrees_with_brute_force(num_points: int, k: int) -> None:
    rng = torch.Generator().manual_seed(num_points + k)
    support, queries = torch.randn(num_points, 3, generator=rng), torch.randn(70, 3, generator=rng)
    index, distance = nearest_neighbors(support, queries, k)
    wanted, far = brute_force(support, queries, k)
    assert index.shape == (70, min(k, num_points))
    assert index.dtype == torch.int64
    assert distance.dtype == torch.float32
    np.testing.assert_array_equal(index.numpy(), wanted)
    np.testing.assert_allclose(distance.numpy(), far, rtol=1e-6)


def test_equal_distances_go_to_the_lower_index() -> None:
    corners = torch.tensor([[x, y, z] for x in (1.0, -1.0) for y in (1.0, -1.0) for z in (1.0, -1.0)])
    index, distance = nearest_neighbors(corners, torch.zeros(1, 3), 4)
    assert index.tolist() == [[0, 1, 2, 3]]
    assert torch.equal(distance, torch.full((1, 4), 3.0).sqrt())


def test_no_queries() -> None:
    index, distance = nearest_neighbors(torch.randn(4, 3), torch.zeros(0, 3), 2)
    assert index.shape == distance.shape == (0, 2)


@pytest.mark.parametrize("k", [1, 5, 39, 60])
def test_others_are_the_neighbours_without_oneself(k: int) -> None:
    points = torch.randn(40, 3, generator=torch.Generator().manual_seed(k))
    own = torch.tensor([3, 0, 39, 17])
    index, distance = nearest_others(NeighborTree(points), points[own], own, k)
    for row, me in enumerate(own.tolist()):
        others = [i for i in range(40) if i != me]
        wanted, far = brute_force(points[others], points[me : me + 1], k)
        assert index[row].tolist() == [others[i] for i in wanted[0]]
        np.testing.assert_allclose(distance[row].numpy(), far[0], rtol=1e-6)


def test_others_among_twins() -> None:
    points = torch.zeros(20, 3)
    own = torch.arange(20)
    index, distance = nearest_others(NeighborTree(points), points, own, 4)
    assert index.shape == (20, 4)
    assert torch.equal(distance, torch.zeros(20, 4))
    for me, row in enumerate(index.tolist()):
        assert len(set(row)) == 4
        assert me not in row


def test_a_lonely_point_has_no_others() -> None:
    points = torch.zeros(1, 3)
    index, distance = nearest_others(NeighborTree(points), points, torch.tensor([0]), 4)
    assert index.shape == distance.shape == (1, 0)
