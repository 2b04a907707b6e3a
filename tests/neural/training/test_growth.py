import dataclasses

import pytest
import torch

from scenes import tiny_cameras
from splatwire.data import Dataset
from splatwire.errors import DivergedError
from splatwire.neural.training.config import GrowthRules, TrainConfig
from splatwire.neural.training.growth import _cells, _keys, adjust_anchors, gather_statistics, on_image
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.state import ANCHOR_PARAMETERS, MAX_TRAINED_INDEX, Moments, TrainState
from splatwire.types import Gaussians


@pytest.fixture
def state(dataset: Dataset, config: TrainConfig) -> TrainState:
    """A state with different offsets and gathered statistics."""
    state = initial_state(dataset, config)
    rng = torch.Generator().manual_seed(1)
    for name in ("offsets", "features"):
        value = torch.randn(state.parameters[name].shape, generator=rng)
        state.parameters[name] = value.requires_grad_()
    for name in ANCHOR_PARAMETERS:
        value = state.parameters[name].detach()
        state.moments[name] = Moments(torch.ones_like(value), torch.ones_like(value), 3)
    return state


def _rules(config: TrainConfig, **changes: float) -> TrainConfig:
    return dataclasses.replace(config, growth=dataclasses.replace(GrowthRules(coarsest_cell=4), **changes))


def _seen(state: TrainState, config: TrainConfig, gradient: float, opacity: float) -> None:
    often = config.milestones.growth_interval + 1.0
    state.statistics.visits += often
    state.statistics.opacity_sum += often * opacity
    state.statistics.gradient_count += often
    state.statistics.gradient_sum += often * gradient


def test_cell_keys_are_unique_and_invertible() -> None:
    rng = torch.Generator().manual_seed(0)
    cells = torch.randint(-MAX_TRAINED_INDEX, MAX_TRAINED_INDEX + 1, (1000, 3), generator=rng)
    cells[0], cells[1] = MAX_TRAINED_INDEX, -MAX_TRAINED_INDEX
    keys = _keys(cells)
    assert torch.equal(_cells(keys), cells)
    assert len(keys.unique()) == len(cells.unique(dim=0))


def test_opaque_anchors_with_small_gradients_are_kept(state: TrainState, config: TrainConfig) -> None:
    before, offsets = state.voxels.clone(), state.parameters["offsets"].detach().clone()
    _seen(state, config, gradient=0.0, opacity=1.0)
    assert adjust_anchors(state, _rules(config)) == (0, 0)
    assert torch.equal(state.voxels, before)
    assert torch.equal(state.parameters["offsets"].detach(), offsets)
    assert all(bool((rows == 0).all()) for rows in vars(state.statistics).values())  # judged, so the statistics restart


def test_transparent_anchors_are_pruned(state: TrainState, config: TrainConfig) -> None:
    _seen(state, config, gradient=0.0, opacity=1.0)
    state.statistics.opacity_sum[::4] = 0
    gone, before = set(map(tuple, state.voxels[::4].tolist())), state.num_anchors
    assert adjust_anchors(state, _rules(config)) == (0, len(gone))
    assert state.num_anchors == before - len(gone)
    assert gone.isdisjoint(map(tuple, state.voxels.tolist()))


def test_rarely_seen_anchors_are_not_pruned(state: TrainState, config: TrainConfig) -> None:
    state.statistics.visits += 1
    state.statistics.gradient_count += 1
    state.statistics.gradient_sum += 100
    assert adjust_anchors(state, _rules(config)) == (0, 0)
    assert bool((state.statistics.visits == 1).all())
    assert bool((state.statistics.gradient_count == 1).all())


def test_offsets_with_large_gradients_spawn_anchors_in_empty_cells(state: TrainState, config: TrainConfig) -> None:
    config = _rules(config, levels=1)
    before, old = state.num_anchors, state.voxels.clone()
    features = state.parameters["features"].detach().clone()
    with torch.no_grad():
        sizes = state.parameters["log_scalings"][:, None, :3].exp()
        centers = state.positions[:, None] + state.parameters["offsets"] * sizes
    cells = torch.round(centers.double() / (state.voxel_size * 4)).long().flatten(0, 1)
    _seen(state, config, gradient=1.0, opacity=1.0)
    added, removed = adjust_anchors(state, config)
    assert removed == 0
    assert 0 < added == state.num_anchors - before
    new = state.voxels[before:]
    assert len(torch.unique(state.voxels, dim=0)) == state.num_anchors  # no two anchors at one position
    assert bool((new % 4 == 0).all())
    occupied = set(map(tuple, torch.round(old / 4).long().tolist()))
    sources = [tuple(cell) for cell in cells.tolist()]
    for row, voxel in enumerate((new // 4).tolist()):
        assert tuple(voxel) not in occupied
        assert tuple(voxel) in sources
        candidates = [i // 4 for i, cell in enumerate(sources) if cell == tuple(voxel)]  # 4 offsets per anchor
        best = features[candidates].amax(dim=0)
        # random selection leaves some sources out
        assert bool((state.parameters["features"][before + row] <= best).all())
    expected = torch.log(torch.tensor(4 * state.voxel_size))
    torch.testing.assert_close(state.parameters["log_scalings"].detach()[before:], expected.expand(added, 6))
    for name in ANCHOR_PARAMETERS:
        assert len(state.moments[name].first) == state.num_anchors
        assert bool((state.moments[name].first[before:] == 0).all())
        assert bool((state.moments[name].first[:before] == 1).all())


def test_the_number_of_anchors_has_a_limit(state: TrainState, config: TrainConfig) -> None:
    _seen(state, config, gradient=1.0, opacity=1.0)
    config = _rules(config, max_anchors=state.num_anchors + 7)
    assert adjust_anchors(state, config)[0] == 7


def test_sizes_are_capped(state: TrainState, config: TrainConfig) -> None:
    with torch.no_grad():
        state.parameters["log_scalings"] += 3
    _seen(state, config, gradient=0.0, opacity=1.0)
    adjust_anchors(state, _rules(config))
    sizes = state.parameters["log_scalings"].detach()
    assert float(sizes[:, 3:].max()) == pytest.approx(0.05)
    assert float(sizes[:, :3].max()) > 0.05


def test_statistics_of_one_view_are_exact(state: TrainState) -> None:
    cameras = tiny_cameras(1, 100, 50)
    means = torch.tensor([[0.0, 0, 0], [50.0, 0, 0], [0.0, 0, -9]])  # in view, outside of it, behind the camera
    gaussians = Gaussians(means, torch.ones(3, 4) / 2, torch.full((3, 3), 0.1), torch.full((3,), 0.25), means)
    assert on_image(gaussians, cameras, 0).tolist() == [True, False, False]
    gradient = torch.tensor([[0.03, 0.04], [1.0, 1.0], [1.0, 1.0]])
    anchors, offsets = torch.tensor([2, 2, 5]), torch.tensor([1, 3, 0])
    gather_statistics(state, torch.tensor([2, 5, 7]), (gaussians, anchors, offsets), gradient, cameras, 0)
    statistics = state.statistics
    assert statistics.visits[[2, 5, 7]].tolist() == [1, 1, 1]
    assert float(statistics.visits.sum()) == 3
    assert statistics.opacity_sum[[2, 5, 7]].tolist() == [0.5, 0.25, 0]
    assert float(statistics.gradient_count.sum()) == 1
    assert float(statistics.gradient_sum[2, 1]) == pytest.approx((1.5**2 + 1.0**2) ** 0.5)  # per half image size


def test_no_anchor_is_pruned_before_the_first_pruning(state: TrainState, config: TrainConfig) -> None:
    _seen(state, config, gradient=0.0, opacity=0.0)
    state.statistics.opacity_sum[: state.num_anchors // 2] += state.statistics.visits[: state.num_anchors // 2]
    state.iteration, before = 99, state.num_anchors
    assert adjust_anchors(state, _rules(config, first_pruning=100)) == (0, 0)
    assert state.num_anchors == before


def test_uniformly_transparent_scene_is_kept_until_half_of_the_growth(state: TrainState, config: TrainConfig) -> None:
    half = config.milestones.growth_end // 2
    for iteration in (1, half):
        _seen(state, config, gradient=0.0, opacity=0.0)
        state.iteration, before = iteration, state.num_anchors
        assert adjust_anchors(state, _rules(config)) == (0, 0)
        assert state.num_anchors == before
    _seen(state, config, gradient=0.0, opacity=0.0)
    state.iteration = half + 1
    with pytest.raises(DivergedError, match=rf"iteration {half + 1}: every anchor has become transparent"):
        adjust_anchors(state, _rules(config))


def test_uniformly_transparent_scene_is_kept_while_no_anchor_may_be_removed(
    state: TrainState, config: TrainConfig
) -> None:
    """A short training is in its second half before anchors have taken shape."""
    _seen(state, config, gradient=0.0, opacity=0.0)
    state.iteration = config.milestones.growth_end // 2 + 1
    assert adjust_anchors(state, _rules(config, first_pruning=state.iteration + 1)) == (0, 0)


def test_few_opaque_anchors_enable_pruning(state: TrainState, config: TrainConfig) -> None:
    _seen(state, config, gradient=0.0, opacity=0.0)
    bright = max(1, state.num_anchors // 50)  # 2 %
    state.statistics.opacity_sum[:bright] = state.statistics.visits[:bright]
    before = state.num_anchors
    assert adjust_anchors(state, _rules(config)) == (0, before - bright)
