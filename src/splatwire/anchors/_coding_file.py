"""Reader and writer of codec parameters in scene files, for the schemas `hacpp` and `causal`."""

from typing import Any

import numpy as np

from splatwire.anchors._scene_reader import MAX_WIDTH, SceneReader
from splatwire.errors import MALFORMED, InvalidValueError
from splatwire.ops.arrays import to_numpy
from splatwire.types import AnchorLayout
from splatwire.types.anchor_config import HacppConfig, HashGridConfig
from splatwire.types.anchor_scene import HacppCoding, HacppContextModel, HashGrid
from splatwire.types.causal_coding import CausalCoding, CausalConfig
from splatwire.types.networks import Mlp

CAUSAL = "causal"
_MAX_LEVELS = 64
_MAX_RESOLUTION = 1 << 16
_MAX_LOG2_ROWS = 24
_CAUSAL_FIELDS = {"steps": "steps", "centres": "zero_points", "middle": "middle", "spread": "spread"}
"""Fields of `CausalCoding` by the names of their tensors in scene files."""


def coding_networks(coding: HacppCoding | CausalCoding) -> dict[str, Mlp]:
    """Returns the networks of the context model, by their names in scene files."""
    if isinstance(coding, CausalCoding):
        return {f"causal.{name}": network for name, network in coding.networks.items()}
    channel = {f"context.channel.{i}": network for i, network in enumerate(coding.context_model.channel)}
    return {"context.prior": coding.context_model.prior, **channel}


def coding_header(coding: HacppCoding | CausalCoding) -> dict[str, Any]:
    """Returns the header fields of a scene file that describe the entropy coding of the anchors.

    These are the configuration of the model that predicts the probabilities of the anchors' attributes, and, only for
    the causal model, the name of the schema.
    """
    config = coding.config
    if isinstance(config, CausalConfig):
        return {"model": CAUSAL, "config": {"layout": vars(config.layout), "context_dim": config.context_dim}}
    grid, steps = vars(config.grid), config.base_steps
    return {"config": {"layout": vars(config.layout), "grid": grid, "base_steps": steps}}


def coding_tensors(coding: HacppCoding | CausalCoding) -> dict[str, Any]:
    """Returns the tensors of a scene file that describe the context model, by name, without network weights."""
    if isinstance(coding, CausalCoding):
        return {f"causal.{name}": getattr(coding, field) for name, field in _CAUSAL_FIELDS.items()}
    grid = coding.context_model.grid
    return {
        "grid.volume_bits": _pack_signs(grid.volume), "grid.planes_bits": _pack_signs(grid.planes),
        "grid.bounds_min": grid.bounds_min, "grid.bounds_max": grid.bounds_max,
    }  # fmt: skip


def read_coding(
    reader: SceneReader, config: HacppConfig | CausalConfig, voxel_size: float
) -> HacppCoding | CausalCoding:
    """Reads the networks and other tensors of the context model from a scene file.

    Args:
        reader: The open file.
        config: Configuration of the context model, from the header; its type selects the schema.
        voxel_size: World units per voxel.

    Raises:
        BitstreamError: If a network or tensor is missing or has a wrong shape.
    """
    if isinstance(config, CausalConfig):
        networks = {name: reader.network(f"causal.{name}", *shape) for name, shape in config.shapes().items()}
        sizes = dict(zip(_CAUSAL_FIELDS, (config.num_steps, 4, 3, 3), strict=True))
        tensors = {name: reader.tensor(f"causal.{name}", (size,)) for name, size in sizes.items()}
        for name in ("steps", "spread"):
            if not bool((tensors[name] > 0).all()):
                raise reader.error(f"causal.{name} is not positive everywhere")
        fields = {field: tensors[name] for name, field in _CAUSAL_FIELDS.items()}
        return CausalCoding(networks, **fields, voxel_size=voxel_size, config=config)
    layout, groups = config.layout, config.layout.feature_groups
    channel = tuple(
        reader.network(f"context.channel.{i}", sum(groups[:i]) + 3 * layout.feature_dim, 3 * size)
        for i, size in enumerate(groups)
    )
    prior = reader.network("context.prior", config.grid.context_dim, config.prior_dim)
    return HacppCoding(HacppContextModel(_read_grid(reader, config), prior, channel), voxel_size, config)


def _pack_signs(signs: Any) -> np.ndarray:
    return np.packbits(to_numpy(signs).reshape(-1) > 0)


def _unpack_signs(bits: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    flat = np.unpackbits(bits, count=int(np.prod(shape)))
    return (flat.astype(np.int8) * 2 - 1).reshape(shape)


def _read_grid(reader: SceneReader, config: HacppConfig) -> HashGrid:
    width = config.grid.features_per_level
    shapes = {"volume": (sum(config.grid.rows(3)), width), "planes": (3, sum(config.grid.rows(2)), width)}
    signs = {}
    for name, shape in shapes.items():
        num_bytes = (int(np.prod([*shape], dtype=object)) + 7) // 8
        signs[name] = _unpack_signs(reader.tensor(f"grid.{name}_bits", (num_bytes,), np.uint8), shape)
    bounds = [reader.tensor(f"grid.{name}", (3,)) for name in ("bounds_min", "bounds_max")]
    if not bool((bounds[0] < bounds[1]).all()):
        raise reader.error("grid.bounds_min is not below grid.bounds_max on every axis")
    return HashGrid(signs["volume"], signs["planes"], bounds[0], bounds[1])


def read_config(reader: SceneReader) -> HacppConfig | CausalConfig:
    """Parses the configuration of the context model in the header of a scene file.

    Raises:
        BitstreamError: If a value is missing, of the wrong type or beyond the format's limits.
    """
    try:
        config = reader.header["config"]
        layout = dict(config["layout"])
        groups = _integers(layout.pop("feature_groups"), _MAX_LEVELS, 1, MAX_WIDTH)
        _integers([*layout.values()], 2, 1, MAX_WIDTH)
        if reader.header.get("model") == CAUSAL:
            (context_dim,) = _integers([config["context_dim"]], 1, 1, MAX_WIDTH)
            return CausalConfig(AnchorLayout(feature_groups=groups, **layout), context_dim)
        grid = dict(config["grid"])
        resolutions = [_integers(grid.pop(f"resolutions_{d}d"), _MAX_LEVELS, 2, _MAX_RESOLUTION) for d in (3, 2)]
        log2_rows = _integers([grid.pop("log2_rows_3d"), grid.pop("log2_rows_2d")], 2, 1, _MAX_LOG2_ROWS)
        _integers([*grid.values()], 1, 1, MAX_WIDTH)
        steps = tuple(config["base_steps"])
        if len(steps) != 3 or not all(isinstance(step, float) and 0 < step < 1e9 for step in steps):
            raise InvalidValueError(f"base steps {steps}")
        shape = HashGridConfig(
            resolutions_3d=resolutions[0],
            resolutions_2d=resolutions[1],
            log2_rows_3d=log2_rows[0],
            log2_rows_2d=log2_rows[1],
            **grid,
        )
        return HacppConfig(AnchorLayout(feature_groups=groups, **layout), shape, steps)
    except MALFORMED as error:
        raise reader.error(f"bad configuration in the header: {error}") from error


def _integers(values: Any, max_count: int, low: int, high: int) -> tuple[int, ...]:
    if not isinstance(values, list) or not 1 <= len(values) <= max_count:
        raise InvalidValueError(f"expected 1 to {max_count} whole numbers, found {str(values)[:80]}")
    for value in values:
        if type(value) is not int or not low <= value <= high:
            raise InvalidValueError(f"{str(value)[:80]} is not a whole number from {low} to {high}")
    return tuple(values)
