"""Imports the model folders of the official Scaffold-GS code: anchors in a PLY file, three networks in other files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatwire.arguments import checked
from splatwire.errors import DatasetError
from splatwire.files.names import path_of
from splatwire.io.formats.ply_file import PlyElement, read_ply
from splatwire.io.model_arguments import load_background
from splatwire.neural.importers._hacpp_files import is_plain, load_torch_file, newest_iteration
from splatwire.neural.importers._hacpp_networks import two_layer_network
from splatwire.neural.importers._plain_context import plain_context
from splatwire.neural.importers._rows import anchors_on_grid, offsets_of
from splatwire.neural.importers._torchscript import is_torchscript, read_torchscript_weights
from splatwire.ops.arrays import to_arrays
from splatwire.types import AnchorLayout, Anchors, AnchorScene, GaussianHeads, HacppCoding, Linear, Mlp

_FILES = {"opacity_mlp": 1, "cov_mlp": 7, "color_mlp": 3}
"""Names of the network files, and the number of outputs per offset of each network."""
_GROUPS = 5


@checked
def import_scaffold(model_dir: Path, *, appearance: int | None = None) -> AnchorScene:
    """Reads an official Scaffold-GS model folder, without executing code in the files.

    Reads `point_cloud.ply` of the newest `point_cloud/iteration_*`, and its networks: `opacity_mlp.pt`, `cov_mlp.pt`
    and `color_mlp.pt`, or all in `checkpoints.pth`. The networks may be TorchScript, as the official code saves them,
    or plain state dictionaries. The voxel size is read from `cfg_args`, otherwise inferred from the positions.

    Scaffold-GS has no context model, so the scene gets one that predicts the same distributions for every anchor.

    Args:
        model_dir: The folder that Scaffold-GS calls its model path.
        appearance: Index of the training camera that sets the colours; only for models with an appearance embedding.

    Returns:
        The scene, on the CPU.

    Raises:
        DatasetError: If a file is missing, damaged or of the wrong shape, or no anchor can be rendered. Also if the
            model uses the feature bank, or has an appearance embedding and `appearance` is None or out of range.
    """
    model_dir = path_of(model_dir, "a model folder")
    iteration = newest_iteration(model_dir)
    vertices = read_ply(iteration / "point_cloud.ply")
    if any(name.startswith("f_mask_") for name in vertices.names):
        raise DatasetError(f"{vertices.path}: has masks, so it is a model of HAC++: use `splatwire import hacpp`")
    states = _states(iteration)
    num_offsets = vertices.columns("f_offset_").shape[1] // 3
    feature_dim = vertices.columns("f_anchor_feat_").shape[1]
    heads = GaussianHeads(*(_head(iteration, states, key, feature_dim, num_offsets, appearance) for key in _FILES))
    anchors, voxel_size = _anchors(vertices, feature_dim, num_offsets, model_dir)
    groups = tuple(len(part) for part in np.array_split(np.arange(feature_dim), min(_GROUPS, feature_dim)))
    context, config = plain_context(anchors, AnchorLayout(feature_dim, num_offsets, groups))
    coding, background = HacppCoding(context, voxel_size, config), load_background(model_dir)
    return to_arrays(AnchorScene(anchors, heads, coding, background=background))


def _states(iteration: Path) -> dict[str, Mapping[str, Tensor]]:
    """Reads the trained tensors of a Scaffold-GS model: network weights, and the appearance embedding if present.

    Args:
        iteration: Folder of the model's iteration, `point_cloud/iteration_N`.

    Returns:
        Mapping from the name of each network to its tensors by name.
    """
    if (iteration / "feature_bank_mlp.pt").exists():
        raise DatasetError(f"{iteration}: the model uses the feature bank (--use_feat_bank), which is not supported")
    together = iteration / "checkpoints.pth"
    if together.is_file():
        content = load_torch_file(together)
        if not isinstance(content, Mapping) or "feature_bank_mlp" in content:
            raise DatasetError(f"{together}: not the networks of a model without feature bank")
        states = {key: content[key] for key in (*_FILES, "appearance") if isinstance(content.get(key), Mapping)}
        if "appearance" in states:
            states["embedding_appearance"] = states.pop("appearance")
    else:
        names = [*_FILES, *(["embedding_appearance"] if (iteration / "embedding_appearance.pt").exists() else [])]
        states = {name: _state(iteration / f"{name}.pt") for name in names}
    for key, state in states.items():
        for name, value in state.items():
            if not is_plain(value):
                raise DatasetError(f"{iteration}: '{key}' / '{name}' is not a tensor of finite numbers")
    return states


def _state(path: Path) -> Mapping[str, Tensor]:
    if is_torchscript(path):
        return read_torchscript_weights(path)
    content: Any = load_torch_file(path)
    if not isinstance(content, Mapping):
        raise DatasetError(f"{path}: neither TorchScript nor a state dictionary")
    return content


def _head(
    iteration: Path,
    states: Mapping[str, Mapping[str, Tensor]],
    key: str,
    feature_dim: int,
    num_offsets: int,
    appearance: int | None,
) -> Mlp:
    """Converts the opacity, covariance or colour network of a Scaffold-GS model to a network of this package.

    The inputs of the result are those of all networks in this package: the anchor's feature, the viewing direction
    and the distance. An appearance embedding becomes a constant.

    Args:
        iteration: Folder of the model's iteration, for messages.
        states: Tensors of each network, and of the appearance embedding if there is one.
        key: Name of the network: `opacity_mlp`, `cov_mlp` or `color_mlp`.
        feature_dim: Number of channels of the anchor feature.
        num_offsets: Number of offsets per anchor.
        appearance: Index of the training camera; None for models without an appearance embedding.

    Raises:
        DatasetError: If the network is missing or has other shapes, or `appearance` does not fit the model.
    """
    # The inputs of the result are the anchor's feature, the viewing direction and the distance. If the network of
    # Scaffold-GS does not use the distance, its weights are 0. An appearance embedding becomes a constant.
    if key not in states:
        raise DatasetError(f"{iteration}: the network {key} is missing")
    state = states[key]
    embedding = states.get("embedding_appearance") if key == "color_mlp" else None
    table = None
    if embedding:
        table = next(iter(embedding.values())).detach().float()
        if appearance is None or not 0 <= appearance < len(table):
            raise DatasetError(
                f"{iteration}: the model's colours depend on the training camera (appearance embedding): choose one "
                f"from 0 to {len(table) - 1} with --appearance"
            )
    width = state["0.weight"].shape[1] if "0.weight" in state and state["0.weight"].dim() == 2 else 0
    extra = 0 if table is None else table.shape[1]
    has_distance = width == feature_dim + 4 + extra
    try:
        network = two_layer_network(
            state, "", feature_dim + 3 + has_distance + extra, _FILES[key] * num_offsets, where=key
        )
    except ValueError as error:
        raise DatasetError(f"{iteration}: {error}") from error
    weight, bias = network.hidden.weight, network.hidden.bias
    if table is not None:
        weight, bias = weight[:, :-extra], bias + weight[:, -extra:] @ table[appearance]
    if not has_distance:
        weight = torch.cat([weight, weight.new_zeros(len(weight), 1)], dim=1)
    return Mlp(Linear(weight, bias), network.output)


def _anchors(vertices: PlyElement, feature_dim: int, num_offsets: int, model_dir: Path) -> tuple[Anchors, float]:
    with np.errstate(over="ignore"):
        scalings = np.exp(vertices.columns("scale_", 6))
    mask = np.ones((len(scalings), num_offsets), dtype=bool)
    return anchors_on_grid(vertices, feature_dim, scalings, offsets_of(vertices, num_offsets), mask, model_dir)
