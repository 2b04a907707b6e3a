"""Codes the signs of the binary hash grid with adaptive models. Rows of the grid that no anchor reads are omitted."""

import numpy as np

from splatwire.codec.anchors.hacpp import _sign_kernels as kernels
from splatwire.codec.anchors.hacpp.grid_lookup import grid_levels
from splatwire.entropy.coder import fresh_models
from splatwire.types.anchor_config import HashGridConfig


def encode_signs(signs: np.ndarray, touched: np.ndarray, config: HashGridConfig) -> bytes:
    """Encodes the signs of all hash-table rows that at least one anchor reads.

    Args:
        signs: The hash tables of all levels, entries -1 or +1, int8 (rows, D).
        touched: Mask of the rows that at least one anchor reads, bool (rows).
        config: Resolutions and table sizes of the hash grid.
    """
    # The decoder derives `touched` from the positions.
    level_of, models = _levels(config)
    buffer = np.empty(2 * int(touched.sum()) * signs.shape[1] + 64, dtype=np.uint8)
    length = kernels.encode_signs(np.ascontiguousarray(signs), touched, level_of, models, buffer)
    return buffer[:length].tobytes()


def decode_signs(data: bytes, touched: np.ndarray, config: HashGridConfig) -> np.ndarray:
    """Decodes the signs of all hash-table rows that at least one anchor reads.

    Args:
        data: Bytes written by `encode_signs`.
        touched: Mask of the rows that at least one anchor reads, bool (rows).
        config: Resolutions and table sizes of the hash grid.

    Returns:
        The hash tables of all levels, int8 (rows, D); rows that no anchor reads are +1.
    """
    level_of, models = _levels(config)
    signs = np.empty((len(touched), config.features_per_level), dtype=np.int8)
    kernels.decode_signs(np.frombuffer(data, dtype=np.uint8), touched, level_of, models, signs)
    return signs


def _levels(config: HashGridConfig) -> tuple[np.ndarray, np.ndarray]:
    rows = grid_levels(config).rows
    level_of = np.repeat(np.arange(len(rows), dtype=np.int64), rows)
    return level_of, fresh_models(len(rows) * config.features_per_level * kernels.STATES)
