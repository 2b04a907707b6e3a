"""Signs of the binary hash grid as bytes: only rows that some anchor reads, with adaptive models."""

import numpy as np

from splatwire.codec.schemas.hacpp.grid_lookup import grid_levels
from splatwire.entropy.coder import fresh_models
from splatwire.model.config import HashGridConfig


def encode_signs(signs: np.ndarray, touched: np.ndarray, config: HashGridConfig) -> bytes:
    """Codes the signs of the touched rows.

    Args:
        signs: int8 (rows, D), -1 or +1, all levels.
        touched: bool (rows), from `touched_rows`; both ends know it from the positions.
        config: Shape of the grid.
    """
    from splatwire.codec.schemas.hacpp import _sign_kernels as kernels

    level_of, models = _levels(config)
    buffer = np.empty(2 * int(touched.sum()) * signs.shape[1] + 64, dtype=np.uint8)
    length = kernels.encode_signs(np.ascontiguousarray(signs), touched, level_of, models, buffer)
    return buffer[:length].tobytes()


def decode_signs(data: bytes, touched: np.ndarray, config: HashGridConfig) -> np.ndarray:
    """Inverse of `encode_signs`.

    Args:
        data: The code.
        touched: bool (rows).
        config: Shape of the grid.

    Returns:
        int8 (rows, D); rows that no anchor reads are +1.
    """
    from splatwire.codec.schemas.hacpp import _sign_kernels as kernels

    level_of, models = _levels(config)
    signs = np.empty((len(touched), config.features_per_level), dtype=np.int8)
    kernels.decode_signs(np.frombuffer(data, dtype=np.uint8), touched, level_of, models, signs)
    return signs


def _levels(config: HashGridConfig) -> tuple[np.ndarray, np.ndarray]:
    from splatwire.codec.schemas.hacpp import _sign_kernels as kernels

    rows = grid_levels(config).rows
    level_of = np.repeat(np.arange(len(rows), dtype=np.int64), rows)
    return level_of, fresh_models(len(rows) * config.features_per_level * kernels.STATES)
