"""Compressed PLY of PlayCanvas and SuperSplat: 16 bytes per Gaussian, within bounds of each 256; axes are ours, RDF.

Element `chunk` has the bounds of positions, logarithmic scales and colours, `vertex` four words of 11, 10 and 11 bits
(positions and scales), 2 and three times 10 (rotation: which of w, x, y, z is largest, and the others), four times 8
(colour, opacity), and `sh` the other coefficients, a byte each from -4 to 4.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.whole import written_whole
from splatwire.formats._columns import build_splats, check_count, join
from splatwire.formats.content import FileContent
from splatwire.formats.outliers import (
    DEFAULT,
    Outliers,
    find_outliers,
    spatial_order,
    treated_positions,
    warn_of_outliers,
)
from splatwire.formats.ply_comments import (
    OFFSET,
    antialiasing_comments,
    origin_comments,
    stated_origin,
    states_antialiasing,
)
from splatwire.formats.ply_file import PlyElement
from splatwire.formats.ply_metadata import metadata_comments, stated_metadata
from splatwire.ops.spherical_harmonics import DC, num_functions
from splatwire.scene.metadata import NO_METADATA, SceneMetadata
from splatwire.scene.origin import NO_ORIGIN, Origin
from splatwire.scene.splats import Splats

CHUNK = 256
_AXES, _CHANNELS = ("x", "y", "z"), ("r", "g", "b")
_BOUNDS = (_AXES, tuple(f"scale_{axis}" for axis in _AXES), _CHANNELS)
_WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_WIDE, _BYTES, _TENS = (11, 10, 11), (8, 8, 8, 8), (2, 10, 10, 10)
_MAX_LOG_SCALE = 20.0
_SH_RANGE = 8.0
_COST = 2.0
"""Outliers are treated where that makes steps of others so many times as fine."""
_VISIBLE_STEP = 1 / 32
"""Steps of colours, and of logarithms of scales, that are too small to matter."""
_DEGREES = {3 * (num_functions(degree) - 1): degree for degree in range(4)}


def content_of_chunks(elements: dict[str, PlyElement]) -> FileContent:
    """Makes Gaussians of the elements of a compressed PLY; comments may hold an offset and ask for antialiasing.

    Raises:
        DatasetError: If an element or property is missing or of a wrong size, or numbers are no Gaussian.
    """
    chunks, vertices = elements["chunk"], elements.get("vertex")
    path = chunks.path
    if vertices is None:
        raise DatasetError(f"{path}: a compressed PLY without element vertex")
    count = check_count(path, len(vertices.rows), vertices.rows.nbytes)
    if len(chunks.rows) != -(-count // CHUNK):
        raise DatasetError(f"{path}: {len(chunks.rows)} chunks for {count} Gaussians, {CHUNK} to a chunk")
    positions, rotations, scales, colors = (_word(vertices, name) for name in _WORDS)
    chunk = np.arange(count) // CHUNK
    rgba = _unpack(colors, _BYTES)
    has_colors = "min_r" in chunks.names
    color = _within(chunks, _BOUNDS[2], chunk, rgba[:, :3]) if has_colors else rgba[:, :3]
    harmonics = [((color - 0.5) / np.float32(DC))[:, None]]
    if "sh" in elements:
        harmonics.append(_harmonics(elements["sh"], count))
    splats = build_splats(
        path,
        means=_within(chunks, _BOUNDS[0], chunk, _unpack(positions, _WIDE)),
        quats=_rotations(rotations),
        log_scales=_within(chunks, _BOUNDS[1], chunk, _unpack(scales, _WIDE)),
        opacities=rgba[:, 3],
        sh=np.concatenate(harmonics, axis=1),
    )
    offset = stated_origin(OFFSET, chunks.comments) or NO_ORIGIN
    return FileContent(splats, offset, states_antialiasing(chunks.comments), stated_metadata(chunks.comments))


def _word(vertices: PlyElement, name: str) -> np.ndarray:
    if name not in vertices.names or (dtype := vertices.rows.dtype[name]).kind != "u" or dtype.itemsize != 4:
        raise DatasetError(f"{vertices.path}: property {name} of 32 bits is missing")
    return np.asarray(vertices.rows[name], np.uint32)


def _unpack(words: np.ndarray, widths: tuple[int, ...]) -> np.ndarray:
    """Fields of words, the highest bits first, from 0 to 1."""
    shifts = np.cumsum((0, *widths[:0:-1]))[::-1]
    fields = [(words >> int(shift) & ((1 << width) - 1)) / np.float32((1 << width) - 1)
              for shift, width in zip(shifts, widths, strict=True)]  # fmt: skip
    return np.stack(fields, axis=1).astype(np.float32)


def _within(chunks: PlyElement, names: tuple[str, ...], chunk: np.ndarray, share: np.ndarray) -> np.ndarray:
    low, high = (chunks.select([f"{side}_{name}" for name in names])[chunk] for side in ("min", "max"))
    return low * (1 - share) + high * share


def _rotations(words: np.ndarray) -> np.ndarray:
    others = (_unpack(words, _TENS)[:, 1:] - np.float32(0.5)) * np.float32(2**0.5)
    rest = np.sqrt(np.maximum(0, 1 - (others**2).sum(axis=1, keepdims=True)))
    places = np.array([[3, 0, 1, 2], [0, 3, 1, 2], [0, 1, 3, 2], [0, 1, 2, 3]])
    return np.take_along_axis(np.concatenate([others, rest], axis=1), places[words >> 30], axis=1)


def _harmonics(element: PlyElement, count: int) -> np.ndarray:
    width = element.count_of("f_rest_")
    if width not in _DEGREES or not width or len(element.rows) != count:
        size = f"{len(element.rows)} rows of {width} harmonics"
        raise DatasetError(f"{element.path}: {size} are not those of {count} Gaussians of degree 1 to 3")
    codes = element.columns("f_rest_", width)
    share = np.where(codes == 0, 0, np.where(codes == 255, 1, (codes + 0.5) / 256))  # the ends are kept
    return ((share - 0.5) * _SH_RANGE).astype(np.float32).reshape(count, 3, -1).transpose(0, 2, 1)


def write_compressed_ply(
    parts: Iterable[Splats],
    path: Path,
    *,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    outliers: Outliers = DEFAULT,
    metadata: SceneMetadata = NO_METADATA,
) -> int:
    """Writes a compressed PLY, Gaussians sorted along a Morton curve, outliers of the positions last.

    Positions are written relative to the origin, which is a comment. See `splatwire.formats.write_splats`.
    """
    remarks = antialiasing_comments(antialiased) + origin_comments(OFFSET, origin)
    remarks += metadata_comments(metadata)
    splats = _sorted(join(path, parts), path, outliers)
    splats = _scales_and_colours(splats, path, outliers)
    means, quats, scales, sh = splats.means, splats.quats, splats.scales, splats.sh
    color = np.concatenate([sh[:, 0] * np.float32(DC) + np.float32(0.5), splats.opacities[:, None]], axis=1)
    logs = np.log(scales).clip(-_MAX_LOG_SCALE, _MAX_LOG_SCALE)
    bounds, shares = zip(*(_normalised(values) for values in (means, logs, color[:, :3])), strict=True)
    rgba = np.concatenate([shares[2], color[:, 3:].clip(0, 1)], axis=1)
    words = np.stack([_pack(shares[0], _WIDE), _packed_rotations(quats), _pack(shares[1], _WIDE), _pack(rgba, _BYTES)])
    rest = sh[:, 1:].transpose(0, 2, 1).reshape(len(means), -1)
    codes = np.trunc((rest / _SH_RANGE + 0.5) * CHUNK).clip(0, CHUNK - 1).astype(np.uint8)
    with written_whole(path) as unfinished, unfinished.open("wb") as file:
        file.write(_header(len(means), rest.shape[1], remarks))
        file.write(np.concatenate(bounds, axis=1).astype("<f4").tobytes())
        file.write(words.T.astype("<u4").tobytes())
        file.write(codes.tobytes())
    return len(means)


def _sorted(splats: Splats, path: Path, treatment: Outliers) -> Splats:
    """Sorts Gaussians in space, and treats outliers that share a chunk with others at a cost to these."""
    column = find_outliers(splats.means)
    splats = splats.select(spatial_order(column))
    usual = int((~column.outside).sum())
    first, end = usual // CHUNK * CHUNK, min(-(-usual // CHUNK) * CHUNK, splats.num_gaussians)
    if end == usual:
        return splats
    places, tops = splats.means[first:end].astype(np.float64), np.array([(1 << width) - 1 for width in _WIDE])
    low, high = column.middle - column.reach, column.middle + column.reach
    spans = [np.ptp(some, axis=0) / tops for some in (places, places.clip(low, high), places[: usual - first])]
    whole, clamped, alone = (float(span.max()) for span in spans)
    if whole < _COST * clamped:
        return splats
    last = splats.num_gaussians if treatment == "prune" else end
    warn_of_outliers(path, treatment, "positions", column, (whole, alone), last - usual)
    return treated_positions(splats, treatment, np.arange(usual, last), column.middle, low, high)


def _scales_and_colours(splats: Splats, path: Path, treatment: Outliers) -> Splats:
    """Treats outliers of scales and colours that make visible steps in their chunks."""
    logs = np.log(splats.scales.astype(np.float64)).clip(-_MAX_LOG_SCALE, _MAX_LOG_SCALE)
    colours = splats.sh[:, 0].astype(np.float64) * DC
    kept = np.ones(splats.num_gaussians, bool)
    for what, values, top in (("scales", logs, (1 << _WIDE[1]) - 1), ("colours", colours, (1 << _BYTES[0]) - 1)):
        column = find_outliers(values)
        chunks = np.unique(np.flatnonzero(column.outside) // CHUNK)
        if not len(chunks):
            continue
        near = values.clip(column.middle - column.reach, column.middle + column.reach)
        alone = np.where(column.outside[:, None], np.nan, values)
        steps = [_largest_span(some, chunks) / top for some in (values, near, alone)]
        if steps[0] < max(_COST * steps[1], _VISIBLE_STEP):
            continue
        warn_of_outliers(path, treatment, what, column, (steps[0], steps[2]))
        if treatment == "prune":
            kept &= ~column.outside
        elif treatment == "clamp":
            splats = _with_values(splats, what, column.outside, near)
    return splats if kept.all() else splats.select(kept)


def _with_values(splats: Splats, what: str, rows: np.ndarray, values: np.ndarray) -> Splats:
    """The Gaussians with other logarithms of scales, or colours less 0.5, in some rows."""
    if what == "scales":
        scales = splats.scales.copy()
        scales[rows] = np.exp(values[rows])
        return replace(splats, scales=scales)
    sh = splats.sh.copy()
    sh[rows, 0] = values[rows] / DC
    return replace(splats, sh=sh)


def _largest_span(values: np.ndarray, chunks: np.ndarray) -> float:
    """Largest range of a component within one of some chunks; NaN is ignored."""
    starts = np.arange(0, len(values), CHUNK)
    spans = np.fmax.reduceat(values, starts) - np.fmin.reduceat(values, starts)
    return float(np.nan_to_num(spans[chunks]).max())


def _normalised(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of each chunk, least and largest side by side, and where between them each value lies."""
    starts = np.arange(0, len(values), CHUNK)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    chunk = np.arange(len(values)) // CHUNK
    span = np.where(high - low < 1e-5, 1, high - low)[chunk]
    return np.concatenate([low, high], axis=1), ((values - low[chunk]) / span).clip(0, 1)


def _pack(shares: np.ndarray, widths: tuple[int, ...]) -> np.ndarray:
    words = np.zeros(len(shares), np.uint32)
    for field, width in enumerate(widths):
        top = (1 << width) - 1
        words = words << np.uint32(width) | np.rint(shares[:, field].astype(np.float64) * top).astype(np.uint32)
    return words


def _packed_rotations(quats: np.ndarray) -> np.ndarray:
    largest = np.abs(quats).argmax(axis=1)
    rows = np.arange(len(quats))
    signed = quats * np.where(quats[rows, largest] < 0, -1, 1)[:, None]
    others = np.stack([np.delete(np.arange(4), axis) for axis in range(4)])[largest]
    shares = np.take_along_axis(signed, others, axis=1) * 2**-0.5 + 0.5
    return largest.astype(np.uint32) << np.uint32(30) | _pack(shares.clip(0, 1), _TENS[1:])


def _header(count: int, rest: int, remarks: list[str]) -> bytes:
    bounds = [f"property float {side}_{name}" for names in _BOUNDS for side in ("min", "max") for name in names]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment splatwire",
        *(f"comment {remark}" for remark in remarks),
        f"element chunk {-(-count // CHUNK)}",
        *bounds,
    ]
    lines += [f"element vertex {count}", *(f"property uint {name}" for name in _WORDS)]
    if rest:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(rest))]
    return ("\n".join(lines) + "\nend_header\n").encode()
