"""Writer of SOG (see `splatwire.io.formats.sog`)."""

import io
import json
import zipfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from splatwire.files.atomic_write import atomic_output
from splatwire.files.kinds import SOG_META_NAME
from splatwire.io.formats._asset import asset_of
from splatwire.io.formats._codebooks import nearest_number, number_codebook, vector_palette
from splatwire.io.formats._columns import join, rounded_bytes
from splatwire.io.formats._rotations import smallest_three
from splatwire.io.formats.outliers import (
    DEFAULT,
    Column,
    Outliers,
    costly_outliers,
    find_outliers,
    local_scales,
    spatial_order,
    treated_positions,
    visible_errors,
    warn_of_errors,
    warn_of_outliers,
)
from splatwire.io.formats.sog import CODES, PALETTE_COLUMNS
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.splats import Splats

_MIN_PALETTE, _MAX_PALETTE = 1024, 65536
_POSITION_TOP = 65535
_MAX_RANGE = 4.0
"""Maximum ratio of the range of all positions to the range without outliers; above it, outliers are moved or removed.
Outliers are moved to within twice the range of the other positions.
"""
_FIXED_DATE = (1980, 1, 1, 0, 0, 0)


def write_sog(
    parts: Iterable[Splats],
    path: Path,
    *,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    outliers: Outliers = DEFAULT,
    metadata: SceneMetadata = NO_METADATA,
) -> int:
    """Writes a bundled SOG with the Gaussians in Morton order (arguments as for `write_splats`)."""
    splats = treat_outliers(join(path, parts), path, outliers)
    column = find_outliers(splats.means)
    position_errors = _position_errors(replace(column, outside=np.zeros(len(column.values), bool)))
    if visible_errors(position_errors, np.median(splats.scales, axis=1)).any():
        warn_of_errors(path, position_errors, local_scales(splats, np.arange(splats.num_gaussians)))
    files = sog_files(splats.select(spatial_order(column)), antialiased=antialiased, origin=origin, metadata=metadata)
    with atomic_output(path) as unfinished, zipfile.ZipFile(unfinished, "w") as bundle:  # images are compressed already
        for name, data in files.items():
            bundle.writestr(zipfile.ZipInfo(name, _FIXED_DATE), data)
    return splats.num_gaussians


def sog_files(
    splats: Splats, *, antialiased: bool = False, origin: Origin = NO_ORIGIN, metadata: SceneMetadata = NO_METADATA
) -> dict[str, bytes]:
    """Returns the files of a SOG by name, `meta.json` last; Gaussians keep their order.

    Args:
        splats: At least one Gaussian; spatial order makes the images smaller.
        antialiased: True if the Gaussians were trained with antialiasing.
        origin: World coordinates of the point that positions are relative to; stored next to the metadata.
        metadata: Metadata of the scene.
    """
    pictures: dict[str, np.ndarray] = {}
    meta = {"version": 2, "asset": asset_of(metadata, origin), "count": splats.num_gaussians}
    if antialiased:
        meta |= {"antialias": True, "model": "antialiased"}  # the second one is for splat-transform of PlayCanvas
    meta["means"] = _means(splats.means.astype(np.float64), pictures)
    logs = np.log(splats.scales)
    meta["scales"] = _coded("scales", logs, np.full(len(logs), 255, np.uint8), pictures)
    pictures["quats.webp"] = _rotations(splats.quats)
    meta["quats"] = {"files": ["quats.webp"]}
    meta["sh0"] = _coded("sh0", splats.sh[:, 0], rounded_bytes(splats.opacities * 255), pictures)
    if splats.degree:
        meta["shN"] = _harmonics(splats.sh[:, 1:], splats.degree, pictures)
    return {
        **{name: _webp(pixels) for name, pixels in pictures.items()},
        SOG_META_NAME: json.dumps(meta).encode(),
    }


def treat_outliers(splats: Splats, path: Path, treatment: Outliers) -> Splats:
    """Treats distant Gaussians (outliers) that widen the range of positions and thus coarsen their quantisation.

    Args:
        splats: The Gaussians.
        path: The file, for messages.
        treatment: `clamp` to move outliers towards the others, `prune` to remove them, or `keep`.
    """
    column = costly_outliers(splats, _position_errors)
    logs, others = _logs(column.values), _logs(column.others)
    low, high = others.min(axis=0), others.max(axis=0)
    span, whole = high - low, np.ptp(logs, axis=0)
    if not (whole > _MAX_RANGE * span).any() or not column.outside.any():
        return splats
    room = span.max() / 2
    bounds = [np.sign(end) * np.expm1(np.abs(end)) for end in (low - room, high + room)]
    beyond = np.flatnonzero(((column.values < bounds[0]) | (column.values > bounds[1])).any(axis=1))
    if not len(beyond):
        return splats
    steps = (float(whole.max()) / _POSITION_TOP, float(span.max()) / _POSITION_TOP)
    warn_of_outliers(path, treatment, "positions", column, steps, len(beyond))
    return treated_positions(splats, treatment, beyond, column.middle, *bounds)


def _position_errors(column: Column) -> np.ndarray:
    """Returns an upper bound on the rounding error of each position that is no outlier.

    Args:
        column: Positions of all Gaussians, with outliers marked.

    Returns:
        Bound on the error along any axis for each of the n positions that are no outliers, world units, float64 (n).
    """
    logs = _logs(column.others)
    half = np.ptp(logs, axis=0) / (2 * _POSITION_TOP)
    return np.asarray(((1 + np.abs(column.others)) * half).max(axis=1))


def _logs(means: np.ndarray) -> np.ndarray:
    return np.sign(means) * np.log1p(np.abs(means))


def _means(means: np.ndarray, pictures: dict[str, np.ndarray]) -> dict[str, object]:
    logs = _logs(means)
    low, high = logs.min(axis=0), logs.max(axis=0)
    span = np.where(high > low, high - low, 1)
    codes = np.rint((logs - low) / span * _POSITION_TOP).astype(np.int64)
    names = ["means_l.webp", "means_u.webp"]
    for name, part in zip(names, (codes & 255, codes >> 8), strict=True):
        pictures[name] = _opaque(part)
    return {"mins": low.tolist(), "maxs": high.tolist(), "files": names}


def _coded(section: str, values: np.ndarray, alpha: np.ndarray, pictures: dict[str, np.ndarray]) -> dict[str, object]:
    codebook = number_codebook(values, CODES)
    name = f"{section}.webp"
    pictures[name] = np.concatenate([nearest_number(values, codebook), alpha[:, None]], axis=1)
    return {"codebook": codebook.tolist(), "files": [name]}


def _rotations(quats: np.ndarray) -> np.ndarray:
    largest, shares = smallest_three(quats)
    return np.concatenate([np.rint(shares * 255).clip(0, 255), 252 + largest[:, None]], axis=1).astype(np.uint8)


def _harmonics(sh: np.ndarray, degree: int, pictures: dict[str, np.ndarray]) -> dict[str, object]:
    count, width, _ = sh.shape
    size = min(max(_MIN_PALETTE, 1 << (count.bit_length() - 1)), _MAX_PALETTE)
    palette, labels = vector_palette(sh.reshape(count, -1), size)
    codebook = number_codebook(palette, CODES)
    rows = np.zeros((-(-len(palette) // PALETTE_COLUMNS) * PALETTE_COLUMNS, width, 3), np.uint8)
    rows[: len(palette)] = nearest_number(palette, codebook).reshape(-1, width, 3)
    names = ["shN_centroids.webp", "shN_labels.webp"]
    pictures[names[0]] = _opaque(rows.reshape(-1, 3)).reshape(-1, PALETTE_COLUMNS * width, 4)
    pictures[names[1]] = _opaque(np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], axis=1))
    return {"count": len(palette), "bands": degree, "codebook": codebook.tolist(), "files": names}


def _opaque(rgb: np.ndarray) -> np.ndarray:
    return np.concatenate([rgb, np.full((len(rgb), 1), 255)], axis=1).astype(np.uint8)


def _webp(pixels: np.ndarray) -> bytes:
    """Encodes values as a lossless WebP image of nearly square shape."""
    if pixels.ndim == 2:
        width = -(-int(np.ceil(np.sqrt(len(pixels)))) // 4) * 4
        height = -(-len(pixels) // (4 * width)) * 4
        pixels = np.pad(pixels, ((0, width * height - len(pixels)), (0, 0))).reshape(height, width, 4)
    file = io.BytesIO()
    Image.fromarray(pixels, "RGBA").save(file, "WEBP", lossless=True, exact=True, quality=100, method=4)
    return file.getvalue()
