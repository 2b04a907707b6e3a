"""Imports the model folders of the official HAC++ code."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.arguments import checked
from splatwire.errors import DatasetError
from splatwire.files.names import path_of
from splatwire.io.formats.ply_file import PlyElement, read_ply
from splatwire.io.model_arguments import load_background
from splatwire.neural.importers._hacpp_files import (
    anchor_ply,
    is_plain,
    load_bounds,
    load_torch_file,
    newest_iteration,
)
from splatwire.neural.importers._hacpp_networks import channel_networks, hash_grid, two_layer_network
from splatwire.neural.importers._rows import anchors_on_grid, offsets_of
from splatwire.ops.arrays import to_arrays
from splatwire.types import (
    AnchorLayout,
    Anchors,
    AnchorScene,
    GaussianHeads,
    HacppCoding,
    HacppConfig,
    HacppContextModel,
    Mlp,
)

_MASK_THRESHOLD = 0.01


@checked
def import_hacpp(model_dir: Path) -> AnchorScene:
    """Reads an official HAC++ model folder, without executing code in the files.

    Reads the newest `point_cloud/iteration_*` (`point_cloud.ply` or `point_cloud.ply.xz`, `checkpoint.pth`) and the
    bounds `bitstreams/x_bound_{min,max}.pkl`. The voxel size is read from `bitstreams/xyz_gpcc.npz`, `metrics.json` or
    `cfg_args`, otherwise inferred from the positions. PLY files may be from before or after HAC++'s encoding.

    Anchors that cannot be rendered are removed. The others keep the order of the PLY file.

    Args:
        model_dir: The folder that HAC++ calls its model path.

    Returns:
        The scene, on the CPU.

    Raises:
        DatasetError: If a file is missing, damaged or of the wrong shape, a network is not finite, or no anchor can
            be rendered. The message names the file.
    """
    # Positions become the float32 nearest to `index * voxel_size`. The channel-context networks of HAC++'s variant
    # for Synthetic-NeRF affect only the bit rate, not decoded values.
    # HAC++ writes two kinds of PLY files with the same header. After decoding: linear scalings, and masks of 0 or
    # 1; recognised by masks that are all 0 or 1 and no negative scaling. Before encoding: logarithms and logits,
    # converted by `scaling = exp(value)` and `mask = sigmoid(value) > 0.01`.
    model_dir = path_of(model_dir, "a model folder")
    iteration = newest_iteration(model_dir)
    checkpoint_path = iteration / "checkpoint.pth"
    checkpoint = _checkpoint(checkpoint_path)
    bounds = load_bounds(model_dir)
    vertices = read_ply(anchor_ply(iteration))
    try:
        grid, grid_config = hash_grid(checkpoint["encoding_xyz"], *bounds)
        channel, groups = channel_networks(checkpoint["deform_mlp"])
        layout = AnchorLayout(sum(groups), vertices.columns("f_offset_").shape[1] // 3, groups)
        config = HacppConfig(layout, grid_config)
        prior = _network(checkpoint, "grid_mlp", config.grid.context_dim, config.prior_dim)
        heads = _heads(checkpoint, layout)
    except (ValueError, KeyError) as error:
        raise DatasetError(f"{checkpoint_path}: {error.args[0]}") from error
    anchors, voxel_size = _anchors(vertices, layout, model_dir)
    context, background = HacppContextModel(grid, prior, channel), load_background(model_dir)
    return to_arrays(AnchorScene(anchors, heads, HacppCoding(context, voxel_size, config), background=background))


def _checkpoint(path: Path) -> Mapping[str, Any]:
    checkpoint = load_torch_file(path)
    wanted = ("opacity_mlp", "cov_mlp", "color_mlp", "grid_mlp", "deform_mlp", "encoding_xyz")
    if not isinstance(checkpoint, Mapping):
        raise DatasetError(f"{path}: expected a dictionary of networks")
    for key in wanted:
        if not isinstance(checkpoint.get(key), Mapping):
            raise DatasetError(f"{path}: has no '{key}'; keys are {', '.join(map(str, list(checkpoint)[:12]))}")
    extra = sorted(str(key) for key in checkpoint if key not in wanted)
    if extra:
        raise DatasetError(f"{path}: has '{extra[0]}', which is not part of HAC++ with its default options")
    for key in wanted:
        for name, value in checkpoint[key].items():
            if not is_plain(value):
                raise DatasetError(f"{path}: '{key}' / '{name}' is not a tensor of finite numbers")
    return checkpoint


def _network(checkpoint: Mapping[str, Any], key: str, num_inputs: int, num_outputs: int) -> Mlp:
    return two_layer_network(checkpoint[key], "", num_inputs, num_outputs, where=key)


def _heads(checkpoint: Mapping[str, Any], layout: AnchorLayout) -> GaussianHeads:
    num_inputs = layout.feature_dim + 4
    return GaussianHeads(
        opacity=_network(checkpoint, "opacity_mlp", num_inputs, layout.num_offsets),
        covariance=_network(checkpoint, "cov_mlp", num_inputs, 7 * layout.num_offsets),
        color=_network(checkpoint, "color_mlp", num_inputs, 3 * layout.num_offsets),
    )


def _anchors(vertices: PlyElement, layout: AnchorLayout, model_dir: Path) -> tuple[Anchors, float]:
    num_offsets = layout.num_offsets
    logits = vertices.columns("f_mask_", num_offsets + 1)[:, :num_offsets]  # the last channel is never read
    scalings = vertices.columns("scale_", 6)
    plain = (logits == 0) | (logits == 1) | np.isnan(logits)
    decoded = bool(plain.all()) and bool(((scalings >= 0) | np.isnan(scalings)).all())
    if decoded:
        mask = logits == 1
    else:
        mask = logits > np.log(_MASK_THRESHOLD / (1 - _MASK_THRESHOLD))
        with np.errstate(over="ignore"):
            scalings = np.exp(scalings)
    offsets = np.where(mask[:, :, None], offsets_of(vertices, num_offsets), np.float32(0))
    return anchors_on_grid(vertices, layout.feature_dim, scalings, offsets, mask, model_dir)
