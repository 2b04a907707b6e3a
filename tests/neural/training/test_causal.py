"""Training of the causal model: its rate equals that of the coder, and a run gives a decodable scene."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from scenes import SMALL_CAUSAL
from splatwire.anchors.voxels import voxel_indices
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.anchors.causal._position_kernels import position_bits
from splatwire.codec.anchors.causal.side_info import read_side_info
from splatwire.data import Dataset
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.neural.training import create_config, train_scene
from splatwire.neural.training.causal import (
    TrainableCausal,
    anchor_bits,
    attribute_steps,
    initialise_causal,
    noisy_causal_attributes,
    position_inputs_of,
)
from splatwire.neural.training.causal_device import DeviceCausal
from splatwire.neural.training.checkpoint import load_checkpoint, save_checkpoint
from splatwire.neural.training.config import RefineConfig, TrainConfig
from splatwire.neural.training.context import AnchorCache
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.finetune import fine_tuning_config, state_of_scene
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.kernels import COMPILED, uniform_from_host
from splatwire.neural.training.progress import estimate_bytes
from splatwire.neural.training.refine import refine_context
from splatwire.neural.training.size import (
    FINAL_EXCESS,
    INITIAL_EXCESS,
    INTEGRAL,
    MAX_LOG_LAMBDA_CHANGE,
    MEASUREMENTS_PER_ENCODING,
    NUM_MEASUREMENTS,
    allowed_excess,
    control_size,
    is_measurement_due,
    next_controller_state,
    stream_bytes,
)
from splatwire.neural.training.state import Moments, SizeController, TrainState
from splatwire.ops.morton import morton_encode

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recipe(config: TrainConfig) -> TrainConfig:
    return dataclasses.replace(config, model=SMALL_CAUSAL, mask_threshold=0.1)


def _scattered(dataset: Dataset, config: TrainConfig) -> TrainState:
    """Anchors at random positions in a box, with attributes of all sizes."""
    rng, state = torch.Generator().manual_seed(2), initial_state(dataset, config)
    state.voxels = torch.unique(torch.randint(-40, 41, (2500, 3), generator=rng), dim=0)
    count, layout = len(state.voxels), config.model.layout
    with torch.no_grad():
        state.parameters["features"] = 3 * torch.randn(count, layout.feature_dim, generator=rng)
        state.parameters["log_scalings"] = 0.3 * torch.randn(count, 4, generator=rng) - 3
        state.parameters["offsets"] = torch.randn(count, layout.num_offsets, 3, generator=rng)
        logits = torch.where(torch.rand(count, layout.num_offsets, generator=rng) < 0.6, 1.0, -9.0)
        logits[:, 0] = 1.0
        state.parameters["mask_logits"] = logits
    return state


@torch.no_grad()
def _estimate(state: TrainState, config: TrainConfig) -> float:
    steps = attribute_steps(state.parameters["log_steps"], config.causal)
    values = noisy_causal_attributes(state, torch.arange(state.num_anchors), steps, uniform_from_host)
    mask = state.masks(config.mask_threshold).float()
    found = anchor_bits(state, config.causal, position_inputs_of(state), values, steps, (mask, mask.amax(dim=1)))
    return float(found.sum()) - 16 * state.num_anchors  # without the estimated bytes of positions


def test_estimated_rate_equals_the_encoded_size(dataset: Dataset, recipe: TrainConfig) -> None:
    state = _scattered(dataset, recipe)
    before = _estimate(state, recipe)
    initialise_causal(state, recipe, position_inputs_of(state))
    estimate = _estimate(state, recipe)
    assert estimate < 0.8 * before
    stream = encode_scene(export_scene(state, recipe), network_tolerance=0.005)
    places = read_side_info(stream.side_info, stream.manifest.num_elements).positions
    voxels = voxel_indices(decode_stream(stream).scene.positions, recipe.voxel_size)
    codes = morton_encode(voxels - places.known.corner)
    pairs = zip(codes, places.known.num_low_bits, strict=True)
    real = (
        stream.part_sizes()["packet_payloads"]
        - sum(position_bits(*pair, places.low_bit_probabilities) for pair in pairs) / 8
    )
    assert abs(estimate / 8 + 2.1 * len(stream.packets) - real) < 0.012 * real


def test_refitting_saves_bytes_and_keeps_the_scene(dataset: Dataset, recipe: TrainConfig) -> None:
    state = _scattered(dataset, recipe)
    initialise_causal(state, recipe, position_inputs_of(state))
    scene = export_scene(state, recipe)
    again = refine_context(scene, RefineConfig(steps=60, batch=1000))
    assert again.anchors is scene.anchors
    sizes = [encode_scene(one, network_tolerance=0.02).part_sizes()["packet_payloads"] for one in (scene, again)]
    assert sizes[1] < 0.999 * sizes[0]


def test_a_run_ends_in_a_stream_that_decodes(dataset: Dataset, recipe: TrainConfig) -> None:
    result = train_scene(dataset, dataset, recipe)
    assert result.test is not None
    received = decode_stream(encode_scene(result.scene))
    assert received.loss_mask.num_lost == 0
    assert received.scene.anchors.num_anchors == result.scene.anchors.num_anchors
    assert bool((result.scene.causal.steps > 0).all())
    going_on = fine_tuning_config(recipe, result.scene)
    state = state_of_scene(result.scene, dataset, going_on)
    back = export_scene(state, going_on)
    for name in ("features", "offsets", "mask"):
        assert np.array_equal(getattr(back.anchors, name), getattr(result.scene.anchors, name)), name
    assert np.array_equal(back.causal.spread, result.scene.causal.spread)


def test_masks_get_gradients_once_the_rate_counts(dataset: Dataset, recipe: TrainConfig) -> None:
    state, model = initial_state(dataset, recipe), TrainableCausal(recipe, COMPILED, AnchorCache(recipe))
    everything = torch.arange(state.num_anchors)
    for iteration, learns in ((1, False), (30, False), (40, True)):
        state.iteration = iteration
        ((_, masks), estimated_bits) = model.simulate_quantisation(state, everything)
        assert masks.requires_grad == learns
        assert (estimated_bits is not None) == learns
    assert bool((model.expected_scalings(state, everything) > 0).all())


def test_unknown_model_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="model"):
        create_config(model="other")


@pytest.mark.parametrize("exponent", [-0.3, -0.5, -0.8])
@pytest.mark.parametrize("wanted", [0.5, 2.0])
def test_lambda_is_adjusted_to_a_target_size(exponent: float, wanted: float) -> None:
    # a scene needs several measurements to reach the size of its lambda
    controller, log_size = SizeController(), 0.0
    for _ in range(NUM_MEASUREMENTS):
        controller = next_controller_state(controller, log_size - math.log(wanted))
        log_size += 0.25 * (exponent * controller.log_lambda_factor - log_size)
    assert abs(log_size - math.log(wanted)) < 0.03
    assert abs(controller.log_lambda_factor) < MAX_LOG_LAMBDA_CHANGE


def test_target_size_run_resumes_with_its_lambda(dataset: Dataset, recipe: TrainConfig, tmp_path: Path) -> None:
    wanted = dataclasses.replace(recipe, weights=dataclasses.replace(recipe.weights, target_bytes=20_000))
    state = initial_state(dataset, wanted)
    times = [i for i in range(1, wanted.milestones.iterations + 1) if is_measurement_due(wanted.milestones, i)]
    assert times[0] > wanted.milestones.context_start
    assert times[-1] > 0.9 * wanted.milestones.iterations
    for iteration in (times[0] - 1, times[0]):
        state.iteration = iteration
        control_size(state, wanted)
        assert (state.size_controller == SizeController()) == (iteration < times[0])
    assert (
        INITIAL_EXCESS
        > allowed_excess(wanted.milestones, times[0])
        > allowed_excess(wanted.milestones, wanted.milestones.iterations)
        == FINAL_EXCESS
    )
    aim = 20_000 * (1 + allowed_excess(wanted.milestones, times[0]))
    missing = math.log(stream_bytes(export_scene(state, wanted)) / aim)
    assert state.size_controller == SizeController(INTEGRAL * missing, missing)
    assert state.current_lambda(wanted.weights) == wanted.weights.rate * math.exp(INTEGRAL * missing)
    save_checkpoint(state, wanted, tmp_path / "a.checkpoint")
    assert load_checkpoint(tmp_path / "a.checkpoint")[0].size_controller == state.size_controller
    control_size(state, recipe)
    assert state.size_controller.log_error == missing


def test_checkpoints_keep_the_tensor_names_of_earlier_releases(
    dataset: Dataset, recipe: TrainConfig, tmp_path: Path
) -> None:
    state = initial_state(dataset, recipe)
    state.moments["log_steps"] = Moments(torch.ones(recipe.causal.num_steps), torch.ones(recipe.causal.num_steps), 3)
    state.parameter_means["zero_points"] = torch.arange(4.0)
    save_checkpoint(state, recipe, tmp_path / "a.checkpoint")
    names = load_file(tmp_path / "a.checkpoint").keys()
    assert {"parameters.steps", "parameters.centres", "first.steps", "second.steps", "mean.centres"} <= names
    back = load_checkpoint(tmp_path / "a.checkpoint")[0]
    assert torch.equal(back.parameters["log_steps"], state.parameters["log_steps"])
    assert torch.equal(back.parameter_means["zero_points"], torch.arange(4.0))
    assert back.moments["log_steps"].steps == 3


def test_sizes_are_interpolated_between_encoded_ones(
    dataset: Dataset, recipe: TrainConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = dataclasses.replace(recipe, weights=dataclasses.replace(recipe.weights, target_bytes=20_000))
    state, sizes = initial_state(dataset, wanted), iter([9000, 9900])
    monkeypatch.setattr("splatwire.neural.training.size.stream_bytes", lambda scene: next(sizes))
    times = [i for i in range(1, wanted.milestones.iterations + 1) if is_measurement_due(wanted.milestones, i)]
    ratios = []
    for iteration in times[: MEASUREMENTS_PER_ENCODING + 1]:
        state.iteration = iteration
        control_size(state, wanted, lambda state: 3000.0)
        aim = 20_000 * (1 + allowed_excess(wanted.milestones, iteration))
        assert state.size_controller.ratio is not None
        assert state.size_controller.log_error == pytest.approx(math.log(3000 * state.size_controller.ratio / aim))
        ratios.append(state.size_controller.ratio)
    assert ratios == pytest.approx([3.0] * (MEASUREMENTS_PER_ENCODING - 1) + [3.3] * 2)
    save_checkpoint(state, wanted, tmp_path / "a.checkpoint")
    assert load_checkpoint(tmp_path / "a.checkpoint")[0].size_controller == state.size_controller


def test_device_size_estimate_equals_the_rate(dataset: Dataset, recipe: TrainConfig) -> None:
    state = _scattered(dataset, recipe)
    initialise_causal(state, recipe, position_inputs_of(state))
    model = DeviceCausal(recipe, dataclasses.replace(COMPILED, asynchronous=True), AnchorCache(recipe))
    expected = (_estimate(state, recipe) + 16 * state.num_anchors) / 8
    assert model.estimate_bytes(state) == pytest.approx(expected, rel=0.005)
    assert model.estimate_bytes(state) == model.estimate_bytes(state)


def test_progress_counts_the_bits_of_positions_once(dataset: Dataset, recipe: TrainConfig) -> None:
    state = _scattered(dataset, recipe)
    initialise_causal(state, recipe, position_inputs_of(state))
    bits = _estimate(state, recipe) + 16 * state.num_anchors
    networks = sum(v.numel() for name, v in state.parameters.items() if name.startswith(("heads.", "causal.")))
    found = estimate_bytes(state, bits / state.num_anchors, recipe.mask_threshold)
    assert found == pytest.approx((bits + 6 * networks) / 8, abs=1)


def test_target_size_requires_a_lambda() -> None:
    with pytest.raises(InvalidValueError, match="lambda above 0"):
        create_config(lmbda=0.0, size=1000)
