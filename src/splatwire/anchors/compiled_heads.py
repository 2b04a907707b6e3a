"""Generates the Gaussians of anchors in a view with compiled networks, for drawing; not differentiable."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int64

from splatwire.ops.arrays import to_arrays, to_numpy
from splatwire.ops.threads import parallel_map
from splatwire.reprs import summary_repr
from splatwire.types import Cameras, Gaussians
from splatwire.types.anchor_scene import AnchorScene, GaussianHeads
from splatwire.types.networks import Linear, Mlp

_BLOCK = 1024  # anchors; a multiple of sixteen


@dataclass(frozen=True, eq=False)
class SpawnedGaussians:
    """Gaussians of a view, and the anchor and offset that generated each.

    Attributes:
        gaussians: The Gaussians, ordered by anchor, then by offset.
        anchor_index: Index of each Gaussian's anchor.
        offset_index: Index of each Gaussian's offset within the anchor.
    """

    gaussians: Gaussians
    anchor_index: Int64[Any, "G"]
    offset_index: Int64[Any, "G"]

    __repr__ = summary_repr


def drawn_gaussians(scene: AnchorScene, cameras: Cameras, view: int) -> Gaussians:
    """Generates the Gaussians seen by camera `view`."""
    return drawn_with_anchors(scene, cameras, view).gaussians


def drawn_with_anchors(scene: AnchorScene, cameras: Cameras, view: int) -> SpawnedGaussians:
    """Generates the Gaussians that camera `view` sees, and the index of the anchor of each Gaussian.

    Returns:
        The Gaussians with opacity of at least 1/255, ordered by anchor.
    """
    from splatwire.anchors import _heads_kernels

    arguments = _arguments(scene, cameras, view)
    num = scene.anchors.num_anchors

    def spawn(first: int) -> tuple[np.ndarray, ...]:
        return _heads_kernels.spawn_block(first, min(first + _BLOCK, num), *arguments)

    blocks = parallel_map(spawn, range(0, max(num, 1), _BLOCK))
    *fields, indices = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    return SpawnedGaussians(Gaussians(*fields), indices[:, 0], indices[:, 1])


def _arguments(scene: AnchorScene, cameras: Cameras, view: int) -> tuple[object, ...]:
    """Returns all arguments of the kernel `spawn_block` except the range of anchors."""
    anchors, hints, nothing = to_arrays(scene.anchors), to_arrays(scene.hints), np.empty(0, np.float32)
    fields = (anchors.positions, anchors.features, anchors.scalings, anchors.offsets, anchors.mask)
    gains: tuple[np.ndarray, ...] = (np.empty(0, np.bool_), nothing, nothing)
    if hints is not None:
        gains = (hints.left_out, hints.size_gain, nothing if hints.opacity_gain is None else hints.opacity_gain)
    K = to_numpy(cameras.Ks[view]).tolist()
    intrinsics = (K[0][0], K[1][1], K[0][2], K[1][2])
    pose = to_numpy(cameras.viewmats[view]).astype(np.float64)
    center = to_numpy(cameras.centers[view]).astype(np.float32)
    camera = (pose, intrinsics, center, cameras.width, cameras.height, float(cameras.near_depth))
    heads = _packed(to_arrays(scene.heads), anchors.features.shape[1] + 4, anchors.mask.shape[1])
    return _arrays(fields), _arrays(gains), camera, *heads


def _arrays(values: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    narrow = (v if v.dtype == np.bool_ else v.astype(np.float32, copy=False) for v in values)
    return tuple(np.ascontiguousarray(v) for v in narrow)


def _packed(heads: GaussianHeads, num_inputs: int, num_offsets: int) -> tuple[object, ...]:
    """Arranges the weights of the head networks in the memory layout of the compiled kernel.

    Returns:
        Hidden width, layers of the opacity network, layers of the other networks, and slopes of the ReLUs.
    """
    width = max(network.hidden.bias.shape[0] for network in (heads.opacity, heads.covariance, heads.color))
    opacity = _pad_hidden(heads.opacity, width, num_inputs, num_offsets)
    shape = _pad_hidden(heads.covariance, width, num_inputs, 7 * num_offsets)
    color = _pad_hidden(heads.color, width, num_inputs, 3 * num_offsets)
    first, second, third = (_packed_layer(network.hidden) for network in (opacity, shape, color))
    last = (first, _packed_layer(opacity.output)), (second, third, _pack_output_layers(shape, color))
    return width, *last, tuple(np.float32(network.negative_slope) for network in (opacity, shape, color))


def _pad_hidden(network: Mlp, width: int, num_inputs: int, num_outputs: int) -> Mlp:
    """Pads the hidden layer of a network with zeros to `width` units.

    Raises:
        ValueError: If the number of inputs or outputs is wrong.
    """
    spare, hidden, output = width - network.hidden.bias.shape[0], network.hidden, network.output
    if (hidden.weight.shape[1], output.bias.shape[0]) != (num_inputs, num_outputs):
        raise ValueError(f"a head of {num_inputs} inputs and {num_outputs} outputs was expected")
    wide = Linear(np.pad(hidden.weight, ((0, spare), (0, 0))), np.pad(hidden.bias, (0, spare)))
    return Mlp(wide, Linear(np.pad(output.weight, ((0, 0), (0, spare))), output.bias), network.negative_slope)


def _packed_layer(layer: Linear) -> np.ndarray:
    """Returns biases and weights of a layer in the layout of the kernel: six outputs at a time."""
    from splatwire.anchors._heads_kernels import ROWS

    table = np.concatenate([layer.bias[None], layer.weight.T])
    table = np.pad(table, ((0, 0), (0, -table.shape[1] % ROWS))).astype(np.float32)
    return np.ascontiguousarray(table.reshape(len(table), -1, ROWS).swapaxes(0, 1)).ravel()


def _pack_output_layers(shape: Mlp, color: Mlp) -> np.ndarray:
    """Combines the output layers of the covariance and the colour network in one table for the compiled kernel.

    Args:
        shape: The covariance network.
        color: The colour network.

    Returns:
        Flat array with one part for each offset of an anchor. A part is a row of biases, followed by one row of weights
        for each hidden unit. The first half of a row belongs to the covariance network, the second half to the colour
        network.
    """
    from splatwire.anchors._heads_kernels import COLOR, LANES

    num_offsets, num_hidden = color.output.bias.shape[0] // 3, color.hidden.bias.shape[0]
    table = np.zeros((num_offsets, 1 + num_hidden + -num_hidden % 4, LANES), np.float32)
    for output, lane in ((shape.output, 0), (color.output, COLOR)):
        lanes = slice(lane, lane + output.bias.shape[0] // num_offsets)
        table[:, 0, lanes] = output.bias.reshape(num_offsets, -1)
        table[:, 1 : num_hidden + 1, lanes] = output.weight.reshape(num_offsets, -1, num_hidden).swapaxes(1, 2)
    return table.ravel()
