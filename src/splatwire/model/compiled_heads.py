"""The Gaussians of a view for drawing, with compiled heads; `gaussian_heads` is the plain, differentiable version."""

import numpy as np
import torch
from torch import Tensor

from splatwire.model.anchor_scene import AnchorScene, GaussianHeads
from splatwire.model.gaussian_heads import SpawnedGaussians, generate_spawned
from splatwire.model.networks import Linear, Mlp
from splatwire.ops.threads import share
from splatwire.scene import Cameras, Gaussians

_BLOCK = 1024  # anchors; a multiple of sixteen


def drawn_gaussians(scene: AnchorScene, cameras: Cameras, view: int) -> Gaussians:
    """The Gaussians of `drawn_with_anchors` alone."""
    return drawn_with_anchors(scene, cameras, view).gaussians


@torch.no_grad()
def drawn_with_anchors(scene: AnchorScene, cameras: Cameras, view: int) -> SpawnedGaussians:
    """Generates what camera `view` sees of `scene`, without gradients; arguments as in `generate_gaussians`.

    Compiled on first use where the scene is float32 on the CPU; elsewhere the plain version does it.

    Returns:
        The Gaussians of all anchors in view whose opacity is at least 1/255, anchor by anchor; the same whatever the
        number of threads.
    """
    positions = scene.anchors.positions
    if positions.device.type != "cpu" or positions.dtype != torch.float32:
        return generate_spawned(scene, cameras, view)
    from splatwire.model import _heads_kernels

    arguments = _arguments(scene, cameras, view)
    num = scene.anchors.num_anchors

    def spawn(first: int) -> tuple[np.ndarray, ...]:
        return _heads_kernels.spawn_block(first, min(first + _BLOCK, num), *arguments)

    blocks = share(spawn, range(0, max(num, 1), _BLOCK))
    *fields, places = (torch.from_numpy(np.concatenate(parts)) for parts in zip(*blocks, strict=True))
    return SpawnedGaussians(Gaussians(*fields), places[:, 0], places[:, 1])


def _arguments(scene: AnchorScene, cameras: Cameras, view: int) -> tuple[object, ...]:
    """What `_heads_kernels.spawn_block` takes after the block's bounds."""
    anchors, hints, nothing = scene.anchors, scene.hints, torch.empty(0)
    fields = (anchors.positions, anchors.features, anchors.scalings, anchors.offsets, anchors.mask)
    gains = (torch.empty(0, dtype=torch.bool), nothing, nothing)
    if hints is not None:
        gains = (hints.left_out, hints.size_gain, nothing if hints.opacity_gain is None else hints.opacity_gain)
    K = cameras.Ks[view].tolist()
    intrinsics = (K[0][0], K[1][1], K[0][2], K[1][2])
    pose, center = cameras.viewmats[view].double().numpy(), cameras.centers[view].to(torch.float32).numpy()
    camera = (pose, intrinsics, center, cameras.width, cameras.height)
    if any(t.shape[0] not in (0, anchors.num_anchors) for t in gains):
        raise ValueError(f"hints of {[t.shape[0] for t in gains]} anchors, the scene has {anchors.num_anchors}")
    heads = _packed(scene.heads, anchors.features.shape[1] + 4, anchors.mask.shape[1])
    return _arrays(fields), _arrays(gains), camera, *heads


def _arrays(tensors: tuple[Tensor, ...]) -> tuple[np.ndarray, ...]:
    return tuple(t.contiguous().numpy() for t in tensors)


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
    pad = torch.nn.functional.pad
    wide = Linear(pad(hidden.weight, (0, 0, 0, spare)), pad(hidden.bias, (0, spare)))
    return Mlp(wide, Linear(pad(output.weight, (0, spare)), output.bias), network.negative_slope)


def _packed_layer(layer: Linear) -> np.ndarray:
    """A layer's biases and then its weights by input, for six outputs at a time, zeros where there are no more."""
    from splatwire.model._heads_kernels import ROWS

    table = torch.cat([layer.bias[None], layer.weight.T])
    spare = -table.shape[1] % ROWS
    table = torch.nn.functional.pad(table, (0, spare)).to(torch.float32)
    return table.view(table.shape[0], -1, ROWS).transpose(0, 1).contiguous().view(-1).numpy()


def _by_offset(shape: Mlp, color: Mlp) -> np.ndarray:
    """Output layers by offset: a row of biases, then a row per hidden number, `shape` first, `color` in later lanes."""
    from splatwire.model._heads_kernels import COLOR, LANES

    num_offsets, num_hidden = color.output.bias.shape[0] // 3, color.hidden.bias.shape[0]
    table = torch.zeros(num_offsets, 1 + num_hidden + -num_hidden % 4, LANES)
    for output, lane in ((shape.output, 0), (color.output, COLOR)):
        lanes = slice(lane, lane + output.bias.shape[0] // num_offsets)
        table[:, 0, lanes] = output.bias.view(num_offsets, -1)
        table[:, 1 : num_hidden + 1, lanes] = output.weight.view(num_offsets, -1, num_hidden).transpose(1, 2)
    return table.view(-1).numpy()
