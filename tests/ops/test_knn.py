import numpy as np
import pytest

from random_numbers import Numbers
from splatwire.ops.knn import NeighborTree, nearest_neighbors, nearest_others


def brute_force(support: np.ndarray, queries: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    distance = np.linalg.norm(queries.astype(np.float64)[:, None] - support.astype(np.float64)[None], axis=2)
    order = np.argsort(distance, axis=1, kind="stable")[:, :k]
    return order, np.take_along_axis(distance, order, axis=1)


@pytest.mark.parametrize(("num_points", "k"), [(500, 1), (500, 8), (500, 128), (5, 8), (1, 3), (0, 3)])
def test_knn_equals_brute_force(num_points: int, k: int) -> None:
    rng = Numbers(num_points + k)
    support, queries = rng.randn(num_points, 3), rng.randn(70, 3)
    index, distance = nearest_neighbors(support, queries, k)
    wanted, far = brute_force(support, queries, k)
    assert index.shape == (70, min(k, num_points))
    assert index.dtype == np.int64
    assert distance.dtype == np.float32
    np.testing.assert_array_equal(index, wanted)
    np.testing.assert_allclose(distance, far, rtol=1e-6)


def test_equal_distances_go_to_the_lower_index() -> None:
    corners = np.array([[x, y, z] for x in (1.0, -1.0) for y in (1.0, -1.0) for z in (1.0, -1.0)], np.float32)
    index, distance = nearest_neighbors(corners, np.zeros((1, 3), np.float32), 4)
    assert index.tolist() == [[0, 1, 2, 3]]
    assert np.array_equal(distance, np.sqrt(np.full((1, 4), 3.0, np.float32)))


def test_knn_accepts_no_queries() -> None:
    index, distance = nearest_neighbors(Numbers(0).randn(4, 3), np.zeros((0, 3), np.float32), 2)
    assert index.shape == distance.shape == (0, 2)


@pytest.mark.parametrize("k", [1, 5, 39, 60])
def test_neighbours_exclude_the_point_itself(k: int) -> None:
    points = Numbers(k).randn(40, 3)
    own = np.array([3, 0, 39, 17])
    index, distance = nearest_others(NeighborTree(points), points[own], own, k)
    for row, me in enumerate(own.tolist()):
        others = [i for i in range(40) if i != me]
        wanted, far = brute_force(points[others], points[me : me + 1], k)
        assert index[row].tolist() == [others[i] for i in wanted[0]]
        np.testing.assert_allclose(distance[row], far[0], rtol=1e-6)


def test_neighbours_among_coincident_points_exclude_the_point_itself() -> None:
    points = np.zeros((20, 3), np.float32)
    own = np.arange(20)
    index, distance = nearest_others(NeighborTree(points), points, own, 4)
    assert index.shape == (20, 4)
    assert np.array_equal(distance, np.zeros((20, 4), np.float32))
    for me, row in enumerate(index.tolist()):
        assert len(set(row)) == 4
        assert me not in row


def test_single_point_has_no_neighbours() -> None:
    points = np.zeros((1, 3), np.float32)
    index, distance = nearest_others(NeighborTree(points), points, np.array([0]), 4)
    assert index.shape == distance.shape == (1, 0)
