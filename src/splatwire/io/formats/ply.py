"""The PLY files of 3DGS, supported by nearly every splat viewer; axes are RDF (right, down, forward).

Properties, in any order: `x y z nx ny nz f_dc_0..2 f_rest_0.. opacity scale_0..2 rot_0..3`. `f_rest` has all
coefficients of red, then green, then blue, `opacity` is a logit, `scale` a natural logarithm and `rot` a quaternion (w,
x, y, z). All are float32; only `x y z` of geo-referenced scenes are float64. `filter_3D` of Mip-Splatting is the
standard deviation of a filter, which is applied while reading.
"""

import hashlib
import logging
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError, InvalidValueError
from splatwire.files.atomic_write import atomic_output
from splatwire.io.formats._columns import MAX_LOG_SCALE, build_splats, check_count, checked_batches
from splatwire.io.formats._placement import warn_of_unused_comments
from splatwire.io.formats._ply_values import warn_of_other_units
from splatwire.io.formats.content import FileContent, warn_of_rounded_positions
from splatwire.io.formats.ply_comments import (
    ORIGIN,
    antialiasing_comments,
    origin_comments,
    stated_origin,
    states_antialiasing,
    warn_of_unclear_antialiasing,
)
from splatwire.io.formats.ply_file import PlyElement
from splatwire.io.formats.ply_metadata import metadata_comments, stated_metadata
from splatwire.io.formats.ply_steps import DIGEST_DIGITS, PlySteps, with_classes
from splatwire.ops.spherical_harmonics import MAX_DEGREE, degree_of, num_functions
from splatwire.types.metadata import NO_METADATA, SceneMetadata, parse_field
from splatwire.types.origin import NO_ORIGIN, Origin, choose_origin, describe_origin, misses_positions
from splatwire.types.splats import CHUNK_GAUSSIANS, Splats

LOG = logging.getLogger(__name__)
_REST_OF_4 = 72
"""Number of properties `f_rest_*` for harmonics of degree 4."""
_AXES = ("x", "y", "z")
_FILTER = re.compile(r"filter[-_ ]?3d", re.IGNORECASE)
"""Property with the standard deviation of the Mip-Splatting filter."""
_CHANGING = re.compile(
    r"filter|mip|anti[-_]?alias|smooth|kernel|motion|trbf|omega|velocity|deleted|hidden|visib|^(?:t|time(?:stamp)?|state)$"
    r"|^(?:active|mask|valid|selected|lod|level|life(?:time)?|duration|weight|exposure|brightness|tint|gamma|shape)(?:[-_]|$)"
    r"|^(?:beta|f_t|f_asg|asg|sg|sb|rot_[rl]|sh_mask)(?:[-_]|$)|^(?:scal\w*|rot\w*|opacity)_t(?:[-_]|$)|^t_scal",
    re.IGNORECASE,
)
"""Name patterns of properties that may change, move or hide Gaussians in an unknown way."""
_HINTS = {
    1: "; isotropic Gaussians have their only size three times: write scale_0, scale_1 and scale_2",
    2: "; those of 2DGS are flat: add a property scale_2 of -30, the logarithm of a thickness near 0",
    6: "; a PLY of anchors is read by `splatwire import scaffold` or `hacpp`",
}
"""Hints for files with another number of scales."""
_ORBIT_ELEMENTS = {"safe_orbit_camera_elevation_min_max_radians": 2, "safe_orbit_camera_radius_min": 1}
"""Names and numbers of rows of the elements with limits of an orbit."""
_FLOAT_BYTES = 4
_LINEAR_RGB = 1
"""Value of the element `color_space` of SHARP for linear RGB; 0 is sRGB."""
_COUNT_DIGITS = 12
_MIN_OPACITY = 1e-6
"""Minimum distance of written opacities from 0 and 1, where the logit is infinite."""


def content_of_vertices(vertices: PlyElement) -> FileContent:
    """Builds Gaussians from the vertices of a 3DGS PLY.

    If the positions are far from 0, the result has an origin near the Gaussians, and its positions are relative to this
    origin.

    Raises:
        DatasetError: If a property is missing, or values are invalid.
    """
    path = vertices.path
    check_count(path, len(vertices.rows), vertices.rows.nbytes)
    if vertices.count_of("scale_") != 3:
        count = vertices.count_of("scale_")
        hint = _HINTS.get(1 if not count and "scale" in vertices.names else count, "")
        raise DatasetError(f"{path}: has {count} properties scale_*, explicit Gaussians have 3{hint}")
    if not vertices.count_of("f_dc_") and {"red", "green", "blue"} <= set(vertices.names):
        raise DatasetError(
            f"{path}: has colours (red, green, blue) and no properties f_dc_*: write f_dc = (colour - 0.5) / "
            "0.28209479 with colours from 0 to 1 (bytes divided by 255)"
        )
    num_rest = vertices.count_of("f_rest_")
    try:
        degree = MAX_DEGREE if num_rest == _REST_OF_4 else degree_of(num_rest // 3 + 1 if num_rest % 3 == 0 else -1)
    except InvalidValueError as error:
        raise DatasetError(f"{path}: {num_rest} properties f_rest_* are not those of a degree from 0 to 4") from error
    if num_rest == _REST_OF_4:
        LOG.warning(
            "%s: harmonics of degree 4 are read up to degree %d: %d of %d coefficients of each Gaussian are left out",
            path, MAX_DEGREE, _REST_OF_4 + 3 - 3 * num_functions(MAX_DEGREE), _REST_OF_4 + 3,
        )  # fmt: skip
    warn_of_unclear_antialiasing(path, vertices.comments)
    warn_of_unused_comments(path, vertices.comments, ORIGIN)
    unknown = [name for name in vertices.names if _CHANGING.search(name) and not _FILTER.fullmatch(name)]
    unknown += [name for name in vertices.names if _FILTER.fullmatch(name)][1:]
    if unknown:
        LOG.warning(
            "%s: properties %s are not known and left out: the scene may look different",
            path, ", ".join(unknown)[:200],
        )  # fmt: skip
    warn_of_other_units(vertices)
    splats, origin = Splats.empty(len(vertices.rows), degree), _origin(vertices)
    for begin in range(0, len(vertices.rows), CHUNK_GAUSSIANS):
        splats.fill(
            begin,
            _splats_of_rows(replace(vertices, rows=vertices.rows[begin : begin + CHUNK_GAUSSIANS]), num_rest, origin),
        )
    if min(vertices.rows.dtype[name].itemsize for name in _AXES) <= _FLOAT_BYTES:
        warn_of_rounded_positions(path, splats, origin)
    metadata = stated_metadata(vertices.comments, path).moved_origin(NO_ORIGIN, origin)
    return FileContent(splats, origin, states_antialiasing(vertices.comments), metadata)


def warn_of_other_gaussians(elements: dict[str, PlyElement]) -> None:
    """Logs a warning if elements other than `vertex` also have Gaussians, which are not read."""
    other_elements = [
        element for element in elements.values() if element.name != "vertex" and {"x", "opacity"} <= set(element.names)
    ]
    if other_elements:
        LOG.warning(
            "%s: only the element vertex is read: %s Gaussians of %s are left out",
            other_elements[0].path, f"{sum(len(element.rows) for element in other_elements):,}",
            ", ".join(element.name for element in other_elements)[:120],
        )  # fmt: skip


def warn_of_colour_space(elements: dict[str, PlyElement]) -> None:
    """Logs a warning if a PLY declares linear RGB in the element `color_space`, which the program SHARP writes."""
    color_space = elements.get("color_space")
    if (
        color_space is not None
        and color_space.names
        and color_space.rows[color_space.names[0]][:1].tolist() == [_LINEAR_RGB]
    ):
        LOG.warning(
            "%s: element color_space is %d, linear RGB: colours are read as sRGB and may look too dark",
            color_space.path, _LINEAR_RGB,
        )  # fmt: skip


def orbit_of_elements(elements: dict[str, PlyElement]) -> tuple[float, float, float] | None:
    """Returns the limits of an orbit that the reference software of SPZ writes into a PLY as elements.

    Returns:
        Smallest and largest elevation, radians, and smallest radius, world units; None if an element is missing or has
        other values.
    """
    values: list[float] = []
    for name, count in _ORBIT_ELEMENTS.items():
        element = elements.get(name)
        if element is None or element.names != (name,) or len(element.rows) != count:
            return None
        values += element.select_float64([name])[:, 0].tolist()
    low, high, radius = values
    try:
        return SceneMetadata(orbit=parse_field("orbit", [low, high, radius])).orbit
    except InvalidValueError:
        return None


def _origin(vertices: PlyElement) -> Origin:
    """Returns the origin for the positions of a PLY: the one in its comments, or one near the Gaussians.

    An origin in the comments that is far from the Gaussians is ignored with a warning.

    Args:
        vertices: The vertices, in world coordinates.

    Returns:
        The origin; `NO_ORIGIN` if the comments have none and the Gaussians are near 0.
    """
    means = vertices.sample().select_float64(list(_AXES))
    stated = stated_origin(ORIGIN, vertices.comments)
    if stated is not None and (distance := misses_positions(stated, means)) is None:
        return stated
    has_doubles = any(vertices.rows.dtype[name].itemsize > _FLOAT_BYTES for name in _AXES)
    chosen = choose_origin(means, low_thresholds=has_doubles)
    if stated is not None:
        LOG.warning(
            "%s: its comment has the origin (%s), which is %.6g away from the Gaussians: it may be of another file; "
            "positions are read as they are in the file, relative to (%s)",
            vertices.path, describe_origin(stated), distance, describe_origin(chosen),
        )  # fmt: skip
    return chosen


def _splats_of_rows(vertices: PlyElement, num_rest: int, origin: Origin) -> Splats:
    harmonics = [vertices.columns("f_dc_", 3)[:, None]]
    if num_rest:
        rest = vertices.columns("f_rest_", num_rest)
        harmonics.append(rest.reshape(len(rest), 3, -1).transpose(0, 2, 1)[:, : num_functions(MAX_DEGREE) - 1])
    log_scales, opacities = vertices.columns("scale_", 3), _expit(vertices.select(["opacity"])[:, 0])
    if filters := [name for name in vertices.names if _FILTER.fullmatch(name)]:
        log_scales, opacities = _smoothed(log_scales, opacities, vertices.select_float64(filters[:1]))
    return build_splats(
        vertices.path,
        means=vertices.select_float64(list(_AXES)) - np.array(origin),
        quats=vertices.columns("rot_", 4),
        log_scales=log_scales,
        opacities=opacities,
        sh=np.concatenate(harmonics, axis=1),
    )


def _smoothed(log_scales: np.ndarray, opacities: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Applies the 3D smoothing filter of Mip-Splatting to Gaussians (Yu et al., CVPR 2024, equation 9).

    Args:
        log_scales: float32 (N, 3), logarithms of standard deviations.
        opacities: float32 (N).
        sizes: Standard deviation of the filter of each Gaussian, float64 (N, 1).

    Returns:
        Logarithms of the standard deviations, and opacities, after filtering.
    """
    logs = np.maximum(log_scales.astype(np.float64), -MAX_LOG_SCALE)
    with np.errstate(divide="ignore"):
        smoothed_logs = np.logaddexp(2 * logs, 2 * np.log(np.abs(sizes))) / 2
    return smoothed_logs.astype(np.float32), (opacities * np.exp((logs - smoothed_logs).sum(axis=1))).astype(np.float32)


def _expit(logits: np.ndarray) -> np.ndarray:
    """Logistic function in float32."""
    with np.errstate(over="ignore"):
        # scipy.special.expit differs in the last digit of 1 in 4,000 values, and takes 0.3 s to import
        return 1 / (1 + np.exp(-logits.astype(np.float64)).astype(np.float32))


def write_ply(
    parts: Iterable[Splats],
    path: Path,
    steps: PlySteps | None = None,
    *,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    metadata: SceneMetadata = NO_METADATA,
) -> int:
    """Writes a PLY batch by batch (arguments as for `write_splats`); returns the number of Gaussians."""
    count, degree, digest = 0, 0, hashlib.sha256()
    remarks = antialiasing_comments(antialiased) + origin_comments(ORIGIN, origin)
    remarks += metadata_comments(metadata.moved_origin(origin, NO_ORIGIN))
    with atomic_output(path) as unfinished, unfinished.open("wb") as file:
        for part in checked_batches(path, parts):
            if not count:
                degree = part.degree
                file.write(_header(0, degree, steps, digest.hexdigest(), remarks, origin))
            rows, end = _rows(part), count + part.num_gaussians
            rows = rows if steps is None else with_classes(rows, steps.classes[count:end])
            data = _record_bytes(rows, origin)
            digest.update(data)
            file.write(data)
            count = end
        file.seek(0)
        file.write(_header(count, degree, steps, digest.hexdigest(), remarks, origin))
    return count


def _record_bytes(rows: np.ndarray, origin: Origin) -> bytes:
    """Serialises Gaussians as records of a PLY.

    All values are float32. With an origin, positions are world coordinates in float64.
    """
    if origin == NO_ORIGIN:
        return rows.astype("<f4").tobytes()
    records = np.empty(len(rows), [("means", "<f8", 3), ("rest", "<f4", rows.shape[1] - 3)])
    records["means"] = rows[:, :3] + np.array(origin)
    records["rest"] = rows[:, 3:]
    return records.tobytes()


def property_names(degree: int) -> list[str]:
    """Returns the names of a vertex's properties in file order.

    Args:
        degree: Degree of the spherical harmonics.
    """
    rest = 3 * ((degree + 1) ** 2 - 1)
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(rest)),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def _header(count: int, degree: int, steps: PlySteps | None, digest: str, remarks: list[str], origin: Origin) -> bytes:
    """Returns the header of a PLY file.

    The length does not depend on the number of Gaussians. A writer can thus overwrite the header when the number is
    known.

    Args:
        count: Number of Gaussians.
        degree: Degree of their spherical harmonics.
        steps: Quantisation steps to store; None for none.
        digest: Digest of the vertices. Readers compare it to detect that the vertices were changed and the steps no
            longer apply.
        remarks: Texts of further comments.
        origin: World coordinates of the origin. Positions are float32 if this is (0, 0, 0), else float64.
    """
    digits = str(count)
    lines = ["ply", "format binary_little_endian 1.0", "comment splatwire" + "." * (_COUNT_DIGITS - len(digits))]
    lines += [] if steps is None else [steps.line(digest[:DIGEST_DIGITS])]
    lines += [f"comment {remark}" for remark in remarks]
    double_names = _AXES if origin != NO_ORIGIN else ()
    types = {name: "double" if name in double_names else "float" for name in property_names(degree)}
    lines += [f"element vertex {digits}", *(f"property {kind} {name}" for name, kind in types.items())]
    return ("\n".join(lines) + "\nend_header\n").encode()


def _rows(part: Splats) -> np.ndarray:
    means, quats, scales, sh = part.means, part.quats, part.scales, part.sh
    opacities = np.clip(part.opacities.astype(np.float64), _MIN_OPACITY, 1 - _MIN_OPACITY)
    rest = sh[:, 1:].transpose(0, 2, 1).reshape(len(means), -1)
    logits = np.log(opacities / (1 - opacities))[:, None]
    logs = np.log(scales)
    return np.concatenate([means, np.zeros_like(means), sh[:, 0], rest, logits, logs, quats], axis=1)
