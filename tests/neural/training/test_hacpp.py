import pytest
import torch

from splatwire.codec import encode_scene
from splatwire.data import Dataset
from splatwire.neural.model.tensors import run_network
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.context import AnchorCache
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.hacpp import estimate_sample_bits, grid_features, initialise_prior, step_network
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.rate import binary_entropy_bits
from splatwire.neural.training.state import TrainState


def _scattered(dataset: Dataset, config: TrainConfig) -> TrainState:
    """Anchors at random positions in a box, with attributes of all sizes."""
    rng = torch.Generator().manual_seed(2)
    state = initial_state(dataset, config)
    count = 3000
    state.voxels = torch.unique(torch.randint(-40, 41, (count, 3), generator=rng), dim=0)
    count = len(state.voxels)
    shapes = {name: (count, *state.parameters[name].shape[1:]) for name in ("features", "log_scalings", "offsets")}
    with torch.no_grad():
        state.parameters["features"] = 3 * torch.randn(shapes["features"], generator=rng)
        state.parameters["log_scalings"] = 0.3 * torch.randn(shapes["log_scalings"], generator=rng) - 3
        state.parameters["offsets"] = torch.randn(shapes["offsets"], generator=rng)
        logits = torch.where(torch.rand(count, config.model.layout.num_offsets, generator=rng) < 0.6, 1.0, -9.0)
        logits[:, 0] = 1.0
        state.parameters["mask_logits"] = logits
    return state


def _masks(state: TrainState) -> tuple[torch.Tensor, torch.Tensor]:
    mask = (state.parameters["mask_logits"] > 0).float()
    return mask, mask.amax(dim=1)


@pytest.mark.slow
def test_estimated_rate_equals_the_encoded_size(dataset: Dataset, config: TrainConfig) -> None:
    state = _scattered(dataset, config)
    initialise_prior(state, config)
    everything = torch.arange(state.num_anchors)
    with torch.no_grad():
        features = grid_features(state, AnchorCache(config), everything)
        estimated_bits = estimate_sample_bits(state, config, features, everything, _masks(state))
    mask = _masks(state)[0]
    mask_bits = binary_entropy_bits(float(mask.sum()), mask.numel())
    stream = encode_scene(export_scene(state, config), network_tolerance=0.005)
    real = stream.part_sizes()["packet_payloads"]
    packets = len(stream.packets)
    estimate = (float(estimated_bits.bits) + mask_bits) / 8 + 2.1 * packets  # 2.1 bytes end a packet's code
    assert abs(estimate - real) < 0.012 * real


def test_calibration_lowers_the_rate_of_a_random_context(dataset: Dataset, config: TrainConfig) -> None:
    state = _scattered(dataset, config)
    everything, cache = torch.arange(state.num_anchors), AnchorCache(config)
    rates = []
    for _ in range(2):
        with torch.no_grad():
            features = grid_features(state, cache, everything)
            rates.append(float(estimate_sample_bits(state, config, features, everything, _masks(state)).bits))
        initialise_prior(state, config)
    assert rates[1] < 0.8 * rates[0]


def test_masked_anchors_have_zero_rate(dataset: Dataset, config: TrainConfig) -> None:
    state = _scattered(dataset, config)
    everything = torch.arange(state.num_anchors)
    zeros = torch.zeros_like(state.parameters["mask_logits"])
    with torch.no_grad():
        features = grid_features(state, AnchorCache(config), everything)
        assert float(estimate_sample_bits(state, config, features, everything, (zeros, zeros[:, 0])).bits) == 0


def test_steps_equal_the_last_columns_of_the_prior(dataset: Dataset, config: TrainConfig) -> None:
    prior = initial_state(dataset, config).networks.prior
    x = torch.randn(5, config.model.grid.context_dim)
    torch.testing.assert_close(run_network(step_network(prior), x), run_network(prior, x)[:, -3:])


def test_cache_is_invalidated_by_new_anchors_and_bounds(dataset: Dataset, config: TrainConfig) -> None:
    state, cache = initial_state(dataset, config), AnchorCache(config)
    first = cache.corners(state)
    assert cache.corners(state) is first
    state.bounds_min = state.bounds_min - 1
    second = cache.corners(state)
    assert second is not first
    state.voxels = state.voxels + 1
    assert cache.corners(state) is not second
    torch.testing.assert_close(cache.positions(state), state.positions)
