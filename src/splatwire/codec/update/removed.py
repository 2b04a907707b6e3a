"""Serialises the mask of Gaussians that an update removes."""

import math

import numpy as np

from splatwire.codec.gaussians.blocks import to_lattice
from splatwire.entropy.coder import decode_bits, encode_bits, fresh_models
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.ops.morton import MAX_AXIS_BITS, morton_encode
from splatwire.types import SplatCoding
from splatwire.types.splats import Splats

GROUP, GROUPS = 16, 16
"""Number of Gaussians in a group, and number of groups in a larger group; all are consecutive along the curve."""


def curve_order(splats: Splats, coding: SplatCoding) -> np.ndarray:
    """Sorts decoded Gaussians along a Morton curve.

    Args:
        splats: The N decoded Gaussians.
        coding: Quantisation parameters of the scene.

    Returns:
        Entry i is the index in `splats` of the i-th Gaussian along the curve, int64 (N).
    """
    # The input order differs between receivers: a page appends new Gaussians, `apply_update` encodes the scene again.
    positions = to_lattice(splats.means.astype(np.float64), coding.lattice_bits, coding.size_log)
    positions -= positions.min(axis=0)
    shift = max(int(positions.max()).bit_length() - MAX_AXIS_BITS, 0)
    codes = morton_encode(positions >> shift)
    order = np.argsort(codes, kind="stable")
    same = codes[order[1:]] == codes[order[:-1]]
    tied = np.flatnonzero(np.append(same, False) | np.append(False, same))
    tied_splats = splats.select(order[tied])
    keys = (tied_splats.means, tied_splats.opacities, tied_splats.scales, tied_splats.quats, tied_splats.sh)
    columns = np.concatenate([values.reshape(len(tied), math.prod(values.shape[1:])) for values in keys], axis=1)
    order[tied] = order[tied][np.lexsort((*columns.T[::-1], codes[order[tied]]))]
    return order


def write_removed(removed: np.ndarray) -> bytes:
    """Serialises a mask of removed Gaussians.

    Args:
        removed: Mask of removed Gaussians, bool (N), in the order of the Gaussians along a Morton curve
            (`curve_order`).
    """
    # Flags for large groups with a set bit, for groups in them with a set bit, and for full groups; then the bits of
    # groups that are neither empty nor full.
    writer, groups = ByteWriter(), _grouped(removed)
    larger = groups.reshape(-1, GROUPS, GROUP)
    some_larger = larger.any(axis=(1, 2))
    inner = larger[some_larger].reshape(-1, GROUP)
    has_removed = inner.any(axis=1)
    mixed = inner[has_removed]
    full = mixed.all(axis=1)
    for bits in map(np.ravel, (some_larger, has_removed, full, mixed[~full])):
        writer.blob(encode_bits(bits.astype(np.uint8), np.zeros(len(bits), np.int64), fresh_models(1)))
    return writer.bytes()


def read_removed(data: bytes, count: int) -> np.ndarray:
    """Reads a mask serialised by `write_removed`, bool (count).

    Raises:
        BitstreamError: If the bytes end before the mask does, or more bytes follow.
    """
    reader = ByteReader(data, "list of removed Gaussians")
    larger = np.zeros((-(-count // (GROUPS * GROUP)), GROUPS, GROUP), bool)
    some_larger = _read_bits(reader, len(larger))
    inner = np.zeros((int(some_larger.sum()) * GROUPS, GROUP), bool)
    has_removed = _read_bits(reader, len(inner))
    full = _read_bits(reader, int(has_removed.sum()))
    mixed = np.ones((len(full), GROUP), bool)
    mixed[~full] = _read_bits(reader, GROUP * int((~full).sum())).reshape(-1, GROUP)
    reader.finish()
    inner[has_removed] = mixed
    larger[some_larger] = inner.reshape(-1, GROUPS, GROUP)
    return larger.ravel()[:count]


def _grouped(removed: np.ndarray) -> np.ndarray:
    """Divides a mask into groups of `GROUP` bits that are coded together, bool (groups, GROUP).

    Bits are appended to the mask to fill the last group.
    """
    padded = np.zeros(-(-len(removed) // (GROUPS * GROUP)) * GROUPS * GROUP, bool)
    padded[: len(removed)] = removed
    end = -(-len(removed) // GROUP) * GROUP
    padded[len(removed) : end] = removed[end - GROUP :].all() if end else False
    return padded.reshape(-1, GROUP)


def _read_bits(reader: ByteReader, count: int) -> np.ndarray:
    return decode_bits(reader.blob(), np.zeros(count, np.int64), fresh_models(1)) != 0
