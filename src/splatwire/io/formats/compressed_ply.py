"""Compressed PLY of PlayCanvas and SuperSplat: 16 bytes per Gaussian, quantised per chunk of 256 Gaussians.

Axes are RDF (right, down, forward). The element `chunk` stores, for each chunk, the minima and maxima of positions,
logarithms of scales, and colours. The element `vertex` stores four words of 32 bits for each Gaussian:

* position: x, y and z with 11, 10 and 11 bits, relative to the chunk's bounds;
* rotation: 2 bits for the index of the largest of w, x, y and z, then 10 bits for each of the other three;
* scale: the logarithms of the three scales with 11, 10 and 11 bits, relative to the chunk's bounds;
* colour: red, green, blue and opacity with 8 bits each.

The element `sh` stores the spherical harmonics coefficients of degree 1 and above, one byte each for the range -4 to 4.
"""

import logging
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.atomic_write import atomic_output
from splatwire.io.formats._chunks import CHUNK, WIDTHS, assign_chunks, position_errors
from splatwire.io.formats._columns import build_splats, check_count, join
from splatwire.io.formats._placement import warn_of_unused_comments
from splatwire.io.formats._rotations import from_smallest_three, smallest_three
from splatwire.io.formats.content import FileContent, warn_of_rounded_positions
from splatwire.io.formats.outliers import (
    DEFAULT,
    SHARES,
    VISIBLE_DIVISOR,
    Column,
    Outliers,
    costly_outliers,
    find_outliers,
    local_scales,
    morton_order,
    spatial_order,
    treated_positions,
    warn_of_clipped,
    warn_of_errors,
    warn_of_outliers,
    warn_of_scales,
)
from splatwire.io.formats.ply_comments import (
    OFFSET,
    antialiasing_comments,
    origin_comments,
    stated_origin,
    states_antialiasing,
    warn_of_unclear_antialiasing,
)
from splatwire.io.formats.ply_file import PlyElement
from splatwire.io.formats.ply_metadata import metadata_comments, stated_metadata
from splatwire.ops.spherical_harmonics import DC, num_functions
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin, check_origin, choose_origin, describe_origin
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
_AXES, _CHANNELS = ("x", "y", "z"), ("r", "g", "b")
_BOUNDS = (_AXES, tuple(f"scale_{axis}" for axis in _AXES), _CHANNELS)
_ELEMENTS = ("chunk", "vertex", "sh")
_WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_WIDE, _BYTES, _TENS = WIDTHS, (8, 8, 8, 8), (2, 10, 10, 10)
_MAX_LOG_SCALE = 20.0
_SH_RANGE = 8.0
_FLOAT_BYTES = 4
_MIN_STEP_RATIO = 2.0
"""Minimum ratio of the quantisation steps with and without outliers for which outliers are moved or removed."""
_VISIBLE_STEP = 1 / 32
"""Maximum quantisation step of colours and of logarithms of scales that is invisible."""
_DEGREES = {3 * (num_functions(degree) - 1): degree for degree in range(4)}


def content_of_chunks(elements: dict[str, PlyElement]) -> FileContent:
    """Decodes the Gaussians of a compressed PLY, given its elements.

    Raises:
        DatasetError: If an element or property is missing or of wrong size, or values are invalid.
    """
    chunks, vertices = elements["chunk"], elements.get("vertex")
    path = chunks.path
    if vertices is None:
        raise DatasetError(f"{path}: a compressed PLY without element vertex")
    count = check_count(path, len(vertices.rows), vertices.rows.nbytes)
    if len(chunks.rows) != -(-count // CHUNK):
        raise DatasetError(f"{path}: {len(chunks.rows)} chunks for {count} Gaussians, {CHUNK} to a chunk")
    unknown = [f"property {name}" for name in vertices.names if name not in _WORDS]
    unknown += [f"element {name}" for name in elements if name not in _ELEMENTS]
    if unknown:
        LOG.warning("%s: %s not known and left out: the scene may look different", path, ", ".join(unknown)[:200])
    positions, rotations, scales, colors = (_word(vertices, name) for name in _WORDS)
    chunk = np.arange(count) // CHUNK
    rgba = _unpack(colors, _BYTES)
    _check_bounds(chunks)
    has_colors = "min_r" in chunks.names
    color = _within(chunks, _BOUNDS[2], chunk, rgba[:, :3]) if has_colors else rgba[:, :3]
    harmonics = [((color - 0.5) / np.float32(DC))[:, None]]
    if "sh" in elements:
        harmonics.append(_harmonics(elements["sh"], count))
    low, high, has_bounds, wide = _position_bounds(chunks)
    share = _unpack(positions, _WIDE)
    splats = build_splats(
        path,
        means=low[chunk] * (1 - share) + high[chunk] * share,
        quats=from_smallest_three((rotations >> 30).astype(np.int64), _unpack(rotations, _TENS)[:, 1:]),
        log_scales=_within(chunks, _BOUNDS[1], chunk, _unpack(scales, _WIDE)),
        opacities=rgba[:, 3],
        sh=np.concatenate(harmonics, axis=1),
    )
    if not wide:
        warn_of_rounded_positions(path, splats, has_bounds)
    warn_of_unclear_antialiasing(path, chunks.comments)
    warn_of_unused_comments(path, chunks.comments, OFFSET)
    offset = stated_origin(OFFSET, chunks.comments) or NO_ORIGIN
    if offset != NO_ORIGIN and has_bounds != NO_ORIGIN:
        LOG.warning(
            "%s: its comment adds the offset (%s) to positions that are already near (%s): it may be of another file",
            path, describe_origin(offset), describe_origin(has_bounds),
        )  # fmt: skip
    origin = check_origin([stated + chosen for stated, chosen in zip(offset, has_bounds, strict=True)])
    metadata = stated_metadata(chunks.comments, path).moved_origin(NO_ORIGIN, has_bounds)
    return FileContent(splats, origin, states_antialiasing(chunks.comments), metadata)


def _check_bounds(chunks: PlyElement) -> None:
    """Checks that the bounds of all chunks are complete and ordered.

    Raises:
        DatasetError: If a minimum exceeds its maximum, or one of the bounds of an attribute is missing.
    """
    for names in _BOUNDS:
        sides = [[f"{side}_{name}" for name in names] for side in ("min", "max")]
        if names == _CHANNELS and not set(sides[0] + sides[1]) & set(chunks.names):
            continue
        low, high = (chunks.select_float64(side) for side in sides)
        if (wrong := (low > high).any(axis=0)).any():
            name = names[int(wrong.argmax())]
            raise DatasetError(f"{chunks.path}: a number of min_{name} is above that of max_{name}")


def _position_bounds(chunks: PlyElement) -> tuple[np.ndarray, np.ndarray, Origin, bool]:
    """Reads the bounds of the positions in each chunk and chooses an origin near the positions.

    Returns:
        Four values:

        * Minimum of each chunk, relative to the origin, float32 (C, 3).
        * Maximum of each chunk, relative to the origin, float32 (C, 3).
        * The origin.
        * True if the bounds in the file are float64.
    """
    names = [[f"{side}_{name}" for name in _BOUNDS[0]] for side in ("min", "max")]
    low, high = (chunks.select_float64(names_of_bound) for names_of_bound in names)
    wide = all(chunks.rows.dtype[name].itemsize > _FLOAT_BYTES for names_of_bound in names for name in names_of_bound)
    origin = choose_origin(np.concatenate([low, high]), low_thresholds=wide)
    return (low - np.array(origin)).astype(np.float32), (high - np.array(origin)).astype(np.float32), origin, wide


def _word(vertices: PlyElement, name: str) -> np.ndarray:
    if name not in vertices.names or (dtype := vertices.rows.dtype[name]).kind != "u" or dtype.itemsize != 4:
        raise DatasetError(f"{vertices.path}: property {name} of 32 bits is missing")
    return np.asarray(vertices.rows[name], np.uint32)


def _unpack(words: np.ndarray, widths: tuple[int, ...]) -> np.ndarray:
    """Extracts bit fields of 32-bit words, scaled to 0 to 1; `widths` are the numbers of bits, highest first."""
    shifts = np.cumsum((0, *widths[:0:-1]))[::-1]
    fields = [(words >> int(shift) & ((1 << width) - 1)) / np.float32((1 << width) - 1)
              for shift, width in zip(shifts, widths, strict=True)]  # fmt: skip
    return np.stack(fields, axis=1).astype(np.float32)


def _within(chunks: PlyElement, names: tuple[str, ...], chunk: np.ndarray, share: np.ndarray) -> np.ndarray:
    low, high = (chunks.select([f"{side}_{name}" for name in names])[chunk] for side in ("min", "max"))
    return low * (1 - share) + high * share


def _harmonics(element: PlyElement, count: int) -> np.ndarray:
    width = element.count_of("f_rest_")
    if width not in _DEGREES or not width or len(element.rows) != count:
        size = f"{len(element.rows)} rows of {width} harmonics"
        raise DatasetError(f"{element.path}: {size} are not those of {count} Gaussians of degree 1 to 3")
    codes = element.columns("f_rest_", width)
    share = np.where(codes == 0, 0, np.where(codes == 255, 1, (codes + 0.5) / 256))  # keeps the end points exact
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
    """Writes a compressed PLY with the Gaussians sorted spatially (arguments as for `write_splats`)."""
    remarks = antialiasing_comments(antialiased) + origin_comments(OFFSET, origin)
    remarks += metadata_comments(metadata)
    splats = _sorted(join(path, parts), path, outliers)
    splats = _scales_and_colours(splats, path, outliers)
    warn_of_scales(path, splats.scales, -_MAX_LOG_SCALE, _MAX_LOG_SCALE)
    warn_of_clipped(path, "harmonics", splats.sh[:, 1:], -_SH_RANGE / 2, _SH_RANGE / 2)
    total, splats = splats.num_gaussians, _order_by_density(splats, path)
    means, quats, scales, sh = splats.means, splats.quats, splats.scales, splats.sh
    color = np.concatenate([sh[:, 0] * np.float32(DC) + np.float32(0.5), splats.opacities[:, None]], axis=1)
    logs = np.log(scales).clip(-_MAX_LOG_SCALE, _MAX_LOG_SCALE)
    bounds, shares = zip(*(_normalised(values) for values in (means, logs, color[:, :3])), strict=True)
    rgba = np.concatenate([shares[2], color[:, 3:].clip(0, 1)], axis=1)
    words = np.stack([_pack(shares[0], _WIDE), _packed_rotations(quats), _pack(shares[1], _WIDE), _pack(rgba, _BYTES)])
    rest = sh[:, 1:].transpose(0, 2, 1).reshape(len(means), -1)
    codes = np.trunc((rest / _SH_RANGE + 0.5) * CHUNK).clip(0, CHUNK - 1).astype(np.uint8)
    with atomic_output(path) as unfinished, unfinished.open("wb") as file:
        file.write(_header(len(means), rest.shape[1], remarks))
        file.write(np.concatenate(bounds, axis=1).astype("<f4").tobytes())
        file.write(words.T.astype("<u4").tobytes())
        file.write(codes.tobytes())
    return total


def _order_by_density(splats: Splats, path: Path) -> Splats:
    """Sorts Gaussians into chunks so that dense regions and distant Gaussians do not share a chunk."""
    index, filling = assign_chunks(splats)
    ordered = splats.select(index)
    if filling.any():
        LOG.info("%s: %s transparent rows keep near and far Gaussians apart", path, f"{int(filling.sum()):,}")
        ordered = replace(ordered, opacities=np.where(filling, np.float32(0), ordered.opacities))
    errors = position_errors(ordered.means.astype(np.float64))
    unsure = ~filling & (errors > np.median(ordered.scales, axis=1) / VISIBLE_DIVISOR)
    if unsure.any():
        rows = np.flatnonzero(~filling)
        warn_of_errors(path, errors[rows], local_scales(splats, index[rows]))
    return ordered


def _sorted(splats: Splats, path: Path, treatment: Outliers) -> Splats:
    """Sorts Gaussians spatially, and treats outliers that make the positions of other Gaussians coarse.

    Args:
        splats: The Gaussians.
        path: The file, for messages.
        treatment: `clamp` to move outliers towards the others, `prune` to remove them, or `keep`.
    """
    if treatment == "prune":
        splats = _without_distant(splats, path)
    column = find_outliers(splats.means)
    splats = splats.select(spatial_order(column))
    usual = int((~column.outside).sum())
    first, end = usual // CHUNK * CHUNK, min(-(-usual // CHUNK) * CHUNK, splats.num_gaussians)
    if end == usual:
        return splats
    positions, tops = splats.means[first:end].astype(np.float64), np.array([(1 << width) - 1 for width in _WIDE])
    low, high = column.middle - column.reach, column.middle + column.reach
    spans = [
        np.ptp(variant, axis=0) / tops for variant in (positions, positions.clip(low, high), positions[: usual - first])
    ]
    whole, clamped, alone = (float(span.max()) for span in spans)
    if whole < _MIN_STEP_RATIO * clamped:
        return splats
    last = splats.num_gaussians if treatment == "prune" else end
    warn_of_outliers(path, treatment, "positions", column, (whole, alone), last - usual)
    return treated_positions(splats, treatment, np.arange(usual, last), column.middle, low, high)


def _without_distant(splats: Splats, path: Path) -> Splats:
    """Removes distant Gaussians if they would make the positions of the remaining Gaussians visibly coarse.

    A chunk's positions are quantised within the chunk's extent, so that a distant Gaussian enlarges the steps. At most
    half of all Gaussians are removed.

    Args:
        splats: The Gaussians.
        path: The file, for warnings.
    """

    def errors(column: Column) -> np.ndarray:
        means = column.others
        order, errors_in_order = morton_order(means), np.empty(len(means))
        errors_in_order[order] = position_errors(means[order])
        return errors_in_order

    column = costly_outliers(splats, errors)
    if column.outside.sum() <= find_outliers(splats.means).outside.sum():
        return splats
    without = replace(column, outside=np.zeros_like(column.outside))
    steps = (2 * float(errors(without).max()), 2 * float(errors(column).max()))
    warn_of_outliers(path, "prune", "positions", column, steps)
    return splats.select(~column.outside)


def _scales_and_colours(splats: Splats, path: Path, treatment: Outliers) -> Splats:
    """Clamps or removes extreme scales and colours if they would make the other values of their chunks visibly coarse.

    Args:
        splats: The Gaussians, in the order of the file.
        path: The file, for messages.
        treatment: `clamp` to move the extreme values towards the others, `prune` to remove their Gaussians, or `keep`.
    """
    logs = np.log(splats.scales.astype(np.float64)).clip(-_MAX_LOG_SCALE, _MAX_LOG_SCALE)
    colours = splats.sh[:, 0].astype(np.float64) * DC
    kept = np.ones(splats.num_gaussians, bool)
    for attribute, values, top in (("scales", logs, (1 << _WIDE[1]) - 1), ("colours", colours, (1 << _BYTES[0]) - 1)):
        column, clipped, steps = _costly_values(values, top)
        if steps[0] < max(_MIN_STEP_RATIO * steps[1], _VISIBLE_STEP):
            continue
        warn_of_outliers(path, treatment, attribute, column, (steps[0], steps[2]))
        if treatment == "prune":
            kept &= ~column.outside
        elif treatment == "clamp":
            splats = _with_values(splats, attribute, column.outside, clipped)
    return splats if kept.all() else splats.select(kept)


def _costly_values(values: np.ndarray, top: int) -> tuple[Column, np.ndarray, list[float]]:
    """Finds extreme scales or colours (outliers) that would make the other values of their chunks visibly coarse.

    Args:
        values: Logarithms of scales, or colours, in the order of the file, float64 (N, 3).
        top: Largest quantised value.

    Returns:
        A tuple of three items:
        * the values with a mask of the outliers;
        * the values with the outliers clipped, float64 (N, 3);
        * the largest quantisation step in three cases: outliers unchanged, outliers clipped, and outliers removed. All
          three are 0 if no chunk has outliers.
    """
    candidates = []
    for share in SHARES:
        column = find_outliers(values, share)
        clipped = values.clip(column.middle - column.reach, column.middle + column.reach)
        alone = np.where(column.outside[:, None], np.nan, values)
        chunks = np.arange(-(-len(values) // CHUNK))
        if share == SHARES[0]:  # few outliers affect no other chunk
            chunks = np.unique(np.flatnonzero(column.outside) // CHUNK)
        steps = [_largest_span(variant, chunks) / top if len(chunks) else 0.0 for variant in (values, clipped, alone)]
        candidates.append((column, clipped, steps))
        if _largest_span(clipped, np.arange(-(-len(values) // CHUNK))) / top < _VISIBLE_STEP:
            return candidates[-1]
    return candidates[0]


def _with_values(splats: Splats, attribute: str, rows: np.ndarray, values: np.ndarray) -> Splats:
    """Returns a copy of Gaussians in which the scales or the colours of given Gaussians are replaced.

    Args:
        splats: All Gaussians.
        attribute: `scales` or `colours`.
        rows: Mask of the Gaussians to change, bool (N).
        values: New values, (N, 3): logarithms of scales, or colours minus 0.5. Rows that are not in the mask `rows` are
            ignored.
    """
    if attribute == "scales":
        scales = splats.scales.copy()
        scales[rows] = np.exp(values[rows])
        return replace(splats, scales=scales)
    sh = splats.sh.copy()
    sh[rows, 0] = values[rows] / DC
    return replace(splats, sh=sh)


def _largest_span(values: np.ndarray, chunks: np.ndarray) -> float:
    """Returns the largest range in any of the chunks: maximum minus minimum of one component.

    Args:
        values: Values in the order of the file, (N, C); NaN is ignored.
        chunks: Indices of the chunks to examine, at least one.
    """
    starts = np.arange(0, len(values), CHUNK)
    spans = np.fmax.reduceat(values, starts) - np.fmin.reduceat(values, starts)
    return float(np.nan_to_num(spans[chunks]).max())


def _normalised(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Maps values, (N, 3), linearly to the range 0 to 1 within each of C chunks before quantisation.

    Returns:
        Minimum and maximum of each chunk, (C, 6); and the mapped values, (N, 3).
    """
    starts = np.arange(0, len(values), CHUNK)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    chunk = np.arange(len(values)) // CHUNK
    span = np.where(high > low, high - low, 1)[chunk]
    return np.concatenate([low, high], axis=1), ((values - low[chunk]) / span).clip(0, 1)


def _pack(shares: np.ndarray, widths: tuple[int, ...]) -> np.ndarray:
    words = np.zeros(len(shares), np.uint32)
    for field, width in enumerate(widths):
        top = (1 << width) - 1
        words = words << np.uint32(width) | np.rint(shares[:, field].astype(np.float64) * top).astype(np.uint32)
    return words


def _packed_rotations(quats: np.ndarray) -> np.ndarray:
    largest, shares = smallest_three(quats)
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
