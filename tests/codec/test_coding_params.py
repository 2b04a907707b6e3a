import dataclasses
import struct

import numpy as np
import pytest
import torch

from reference import hacpp_params as reference
from reference.float_prior import interpolate_hash_grid
from reference.hacpp_grid import lookup_reference
from splatwire.codec.anchors.hacpp.atomic import predict_group, predict_packets
from splatwire.codec.anchors.hacpp.coding_params import dequantise, factor_table, quantise, step_indices
from splatwire.codec.anchors.hacpp.grid_lookup import grid_levels, lookup, touched_rows
from splatwire.codec.anchors.hacpp.side_info import SideInfo, read_side_info, write_side_info
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.neural.model.prior_field import split_prior_outputs
from splatwire.neural.model.tensors import to_tensors
from splatwire.types import AnchorScene


@pytest.fixture(scope="module")
def everything(side_info: SideInfo):
    context = side_info.coding_context()
    feature, outputs = context.predict(side_info.voxels)
    return context, side_info.voxels, feature, outputs


def test_fast_path_equals_plain_torch(everything, scene: AnchorScene) -> None:
    context, voxels, feature, outputs = everything
    units = torch.from_numpy(context.units(voxels))
    plain_feature = reference.context_feature(context, units)
    assert (plain_feature.numpy() == feature).all()
    plain = reference.evaluate(context.prior, plain_feature)
    assert (plain.numpy() == outputs).all()

    predicted = predict_packets(context, outputs)
    steps = reference.step_index(plain, context)
    assert (steps.numpy() == step_indices(outputs, context.config)).all()
    assert (reference.step_factors(steps).numpy() == predicted.factors).all()
    named = split_prior_outputs(plain.double(), context.config)
    spans = {
        0: (named.feature_mean, named.feature_scale, predicted.feature),
        1: (named.scaling_mean, named.scaling_scale, predicted.scaling),
        2: (named.offset_mean, named.offset_scale, predicted.offset),
    }
    for a, (mean, scale, fast) in spans.items():
        slow = reference.normal_indices(mean.long(), scale.long(), steps[:, a], context.config.base_steps[a])
        assert (slow.mean.numpy() == fast[0]).all()
        assert (slow.scale.numpy() == fast[1]).all()


def test_channel_context_equals_plain_torch(everything, scene: AnchorScene) -> None:
    context, _, _, outputs = everything
    predicted = predict_packets(context, outputs)
    symbols = quantise(scene.anchors.features, predicted.factors[:, 0], context.config.base_steps[0])
    activations = context.feature_activations(symbols, predicted.factors[:, 0])
    edges = np.cumsum([0, *context.config.layout.feature_groups])
    plain_outputs, features = torch.from_numpy(outputs).long(), context.config.layout.feature_dim
    factors = torch.from_numpy(predicted.factors[:, 0])
    for group, shared in enumerate(context.shared_sums(outputs)):
        means, scales, weights = predict_group(context, group, shared, activations[:, : edges[group]], outputs)
        before = torch.from_numpy(symbols[:, : edges[group]]).long()
        plain = reference.group_outputs(context, group, plain_outputs, before, factors)
        size = edges[group + 1] - edges[group]
        slow = reference.normal_indices(
            plain[:, :size], plain[:, size : 2 * size], reference.step_index(plain_outputs, context)[:, 0],
            context.config.base_steps[0],
        )  # fmt: skip
        logits = plain_outputs[:, 2 * features + edges[group] : 2 * features + edges[group + 1]]
        assert (slow.mean.numpy() == means).all()
        assert (slow.scale.numpy() == scales).all()
        assert (reference.weight_index(logits, plain[:, 2 * size :]).numpy() == weights).all()


def test_integers_follow_the_float_model(everything, scene: AnchorScene, side_info: SideInfo) -> None:
    feature = everything[2]
    grid, positions = to_tensors((scene.coding.context_model.grid, scene.anchors.positions))
    exact = interpolate_hash_grid(grid, positions, scene.coding.config.grid)
    assert np.abs(feature / 2**14 - exact.numpy()).max() < 3e-3


def test_predictions_do_not_depend_on_the_batch_size(everything) -> None:
    context, voxels, feature, outputs = everything
    for size in (1, 7, 333):
        parts = [context.predict(voxels[i : i + size]) for i in range(0, 3 * size, size)]
        assert (np.concatenate([p[0] for p in parts]) == feature[: 3 * size]).all()
        assert (np.concatenate([p[1] for p in parts]) == outputs[: 3 * size]).all()


def test_lookup_equals_numpy_inside_and_outside_the_box(everything) -> None:
    context, voxels, _, _ = everything
    rng = np.random.default_rng(0)
    units = np.concatenate([context.units(voxels), rng.integers(-(2**43), 2**45, (500, 3))])
    fast = lookup(units, context.signs, context.config.grid)
    assert (fast == lookup_reference(units, context.signs, context.config.grid)).all()
    outside = (units < 0).any(axis=1) & (units > 1 << 44).any(axis=1)
    assert not fast[outside, : 4 * len(context.config.grid.resolutions_3d)].any()


def test_unused_hash_rows_do_not_change_predictions(everything) -> None:
    context, voxels, feature, _ = everything
    units = context.units(voxels)
    touched = touched_rows(units, context.config.grid)
    assert 0 < touched.sum() < grid_levels(context.config.grid).num_rows
    flipped = np.where(touched[:, None], context.signs, -context.signs)
    assert (lookup(units, flipped, context.config.grid) == feature).all()
    for row in np.flatnonzero(touched)[:20]:  # every used row changes the result
        one = context.signs.copy()
        one[row] *= -1
        assert (lookup(units, one, context.config.grid) != feature).any()


@pytest.mark.parametrize("base", [1.0, 0.001, 0.2])
def test_quantise_inverts_dequantise(base: float) -> None:
    rng = np.random.default_rng(4)
    factors = factor_table()[rng.integers(1500, 8193, 200)]
    symbols = rng.integers(-3000, 3000, (200, 5)).astype(np.int32)
    assert (quantise(dequantise(symbols, factors, base), factors, base) == symbols).all()


@pytest.mark.parametrize("width", [0.0, 1e-45, 1e-38, 1e-12])
def test_very_thin_bounds_are_refused_by_writer_and_reader(side_info: SideInfo, width: float) -> None:
    """Fixed-point positions do not fit into 64 bits, because of overflow to infinity or wraparound."""
    low = np.array([0.0, -1.0, -1.0], dtype=np.float32)
    high = np.array([width, 1.0, 1.0], dtype=np.float32)
    thin = dataclasses.replace(side_info, bounds_min=low, bounds_max=high)
    with pytest.raises(InvalidValueError, match="too thin for voxels of"):
        write_side_info(thin)


def test_thin_bounds_in_side_information_are_refused(side_info: SideInfo, side_info_bytes: bytes) -> None:
    old = struct.pack("<6f", *side_info.bounds_min, *side_info.bounds_max)
    new = struct.pack("<6f", 0.0, *side_info.bounds_min[1:], 1e-44, *side_info.bounds_max[1:])
    assert side_info_bytes.count(old) == 1
    with pytest.raises(BitstreamError, match=r"side information: the grid's box .* is too thin"):
        read_side_info(side_info_bytes.replace(old, new), len(side_info.voxels), "morton")
