"""The Gaussians of a view for drawing, with compiled heads; `gaussian_heads` is the plain, differentiable version."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int64

from splatwire.model.anchor_scene import AnchorScene, GaussianHeads
from splatwire.model.networks import Linear, Mlp
from splatwire.ops.arrays import to_arrays, to_numpy
from splatwire.ops.threads import share
from splatwire.reprs import summary_repr
from splatwire.scene import Cameras, Gaussians

_BLOCK = 1024  # anchors; a multiple of sixteen


@dataclass(frozen=True, eq=False)
class SpawnedGaussians:
    """The Gaussians of a view and the anchor that each of them belongs to.

    Attributes:
        gaussians: Anchor by anchor, offsets ascending.
        anchor_index: The anchor of each Gaussian.
        offset_index: Its offset within the anchor.
    """

    gaussians: Gaussians
    anchor_index: Int64[Any, "G"]
    offset_index: Int64[Any, "G"]

    __repr__ = summary_repr


def drawn_gaussians(scene: AnchorScene, cameras: Cameras, view: int) -> Gaussians:
    """The Gaussians of `drawn_with_anchors` alone."""
    return drawn_with_anchors(scene, cameras, view).gaussians


def drawn_with_anchors(scene: AnchorScene, cameras: Cameras, view: int) -> SpawnedGaussians:
    """Generates what camera `view` sees of `scene`, in float32; arguments as in `generate_gaussians`.

    Compiled on first use.

    Returns:
        The Gaussians of all anchors in view whose opacity is at least 1/255, anchor by anchor; the same whatever the
        number of threads.
    """
    from splatwire.model import _heads_kernels

    arguments = _arguments(scene, cameras, view)
    num = scene.anchors.num_anchors

    def spawn(first: int) -> tuple[np.ndarray, ...]:
        return _heads_kernels.spawn_block(first, min(first + _BLOCK, num), *arguments)

    blocks = share(spawn, range(0, max(num, 1), _BLOCK))
    *fields, places = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    return SpawnedGaussians(Gaussians(*fields), places[:, 0], places[:, 1])


def _arguments(scene: AnchorScene, cameras: Cameras, view: int) -> tuple[object, ...]:
    """What `_heads_kernels.spawn_block` takes after the block's bounds."""
    anchors, hints, nothing = to_arrays(scene.anchors), to_arrays(scene.hints), np.empty(0, np.float32)
    fields = (anchors.positions, anchors.features, anchors.scalings, anchors.offsets, anchors.mask)
    gains: tuple[np.ndarray, ...] = (np.empty(0, np.bool_), nothing, nothing)
    if hints is not None:
        gains = (hints.left_out, hints.size_gain, nothing if hints.opacity_gain is None else hints.opacity_gain)
    K = to_numpy(cameras.Ks[view]).tolist()
    intrinsics = (K[0][0], K[1][1], K[0][2], K[1][2])
    pose = to_numpy(cameras.viewmats[view]).astype(np.float64)
    center = to_numpy(cameras.centers[view]).astype(np.float32)
    camera = (pose, intrinsics, center, cameras.width, cameras.height)
    if any(t.shape[0] not in (0, anchors.num_anchors) for t in gains):
        raise ValueError(f"hints of {[t.shape[0] for t in gains]} anchors, the scene has {anchors.num_anchors}")
    heads = _packed(to_arrays(scene.heads), anchors.features.shape[1] + 4, anchors.mask.shape[1])
    return _arrays(fields), _arrays(gains), camera, *heads


def _arrays(values: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    narrow = (v if v.dtype == np.bool_ else v.astype(np.float32, copy=False) for v in values)
    return tuple(np.ascontiguousarray(v) for v in narrow)


def _packed(heads: GaussianHeads, num_inputs: int, num_offsets: int) -> tuple[object, ...]:
    """The networks as the kernel reads them: hidden numbers, layers of the opacity, of the others, slopes."""
    width = max(network.hidden.bias.shape[0] for network in (heads.opacity, heads.covariance, heads.color))
    opacity = _widened(heads.opacity, width, num_inputs, num_offsets)
    shape = _widened(heads.covariance, width, num_inputs, 7 * num_offsets)
    color = _widened(heads.color, width, num_inputs, 3 * num_offsets)
    first, second, third = (_packed_layer(network.hidden) for network in (opacity, shape, color))
    last = (first, _packed_layer(opacity.output)), (second, third, _by_offset(shape, color))
    return width, *last, tuple(np.float32(network.negative_slope) for network in (opacity, shape, color))


def _widened(network: Mlp, width: int, num_inputs: int, num_outputs: int) -> Mlp:
    """The same network with hidden numbers that are zero and count for nothing: in a file each has a width of its own.

    Raises:
        ValueError: If the network takes or gives something else: the kernel checks nothing.
    """
    spare, hidden, output = width - network.hidden.bias.shape[0], network.hidden, network.output
    if (hidden.weight.shape[1], output.bias.shape[0]) != (num_inputs, num_outputs):
        raise ValueError(f"a head of {num_inputs} inputs and {num_outputs} outputs was expected")
    wide = Linear(np.pad(hidden.weight, ((0, spare), (0, 0))), np.pad(hidden.bias, (0, spare)))
    return Mlp(wide, Linear(np.pad(output.weight, ((0, 0), (0, spare))), output.bias), network.negative_slope)


def _packed_layer(layer: Linear) -> np.ndarray:
    """A layer's biases and then its weights by input, for six outputs at a time, zeros where there are no more."""
    from splatwire.model._heads_kernels import ROWS

    table = np.concatenate([layer.bias[None], layer.weight.T])
    table = np.pad(table, ((0, 0), (0, -table.shape[1] % ROWS))).astype(np.float32)
    return np.ascontiguousarray(table.reshape(len(table), -1, ROWS).swapaxes(0, 1)).ravel()


def _by_offset(shape: Mlp, color: Mlp) -> np.ndarray:
    """Output layers by offset: a row of biases, then a row per hidden number, `shape` first, `color` in later lanes."""
    from splatwire.model._heads_kernels import COLOR, LANES

    num_offsets, num_hidden = color.output.bias.shape[0] // 3, color.hidden.bias.shape[0]
    table = np.zeros((num_offsets, 1 + num_hidden + -num_hidden % 4, LANES), np.float32)
    for output, lane in ((shape.output, 0), (color.output, COLOR)):
        lanes = slice(lane, lane + output.bias.shape[0] // num_offsets)
        table[:, 0, lanes] = output.bias.reshape(num_offsets, -1)
        table[:, 1 : num_hidden + 1, lanes] = output.weight.reshape(num_offsets, -1, num_hidden).swapaxes(1, 2)
    return table.ravel()
