import pytest
import torch

from reference.mahalanobis import plain_nearest
from splatwire.paper.mahalanobis import MahalanobisSearch


def cloud(count: int, seed: int, spread: float) -> tuple[torch.Tensor, torch.Tensor]:
    rng = torch.Generator().manual_seed(seed)
    return torch.randn(count, 3, generator=rng), torch.exp(spread * torch.randn(count, 3, generator=rng))


@pytest.mark.parametrize("spread", [0.0, 0.5, 2.0])
@pytest.mark.parametrize("k", [1, 24])
def test_neighbours_equal_a_full_sort_of_distances(spread: float, k: int) -> None:
    points, sizes = cloud(700, 1, spread)
    queries = cloud(150, 2, 0.0)[0]
    index, distance = MahalanobisSearch(points, sizes).query(queries, k)
    plain, far = plain_nearest(points, sizes, queries, k)
    assert torch.equal(index, plain)
    torch.testing.assert_close(distance, far)


def test_large_anchor_is_found_beyond_many_small_ones() -> None:
    """A candidate pool by Euclidean distance would miss this neighbour."""
    points, sizes = torch.rand(500, 3, generator=torch.Generator().manual_seed(0)), torch.full((500, 3), 1e-3)
    points[17], sizes[17] = torch.tensor([40.0, 0.0, 0.0]), torch.tensor([1e3, 1e3, 1e3])
    index, distance = MahalanobisSearch(points, sizes).query(torch.full((1, 3), 0.5), 24)
    assert int(index[0, 0]) == 17
    assert float(distance[0, 0]) == pytest.approx(0.0395, abs=1e-3)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_fewer_points_than_requested_are_returned(count: int) -> None:
    index, distance = MahalanobisSearch(*cloud(count, 3, 1.0)).query(cloud(4, 4, 0.0)[0], 24)
    assert index.shape == distance.shape == (4, count)
    assert (index.sort(dim=1).values == torch.arange(count)).all()


def test_ties_are_broken_by_index_also_for_coincident_anchors() -> None:
    index, distance = MahalanobisSearch(torch.zeros(200, 3), torch.ones(200, 3)).query(torch.zeros(2, 3), 30)
    assert torch.equal(index, torch.arange(30).expand(2, 30))
    assert not distance.any()
