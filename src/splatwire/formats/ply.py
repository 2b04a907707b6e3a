"""The PLY files of 3DGS, which nearly every splat viewer opens; axes are ours, RDF.

Properties, in any order: `x y z nx ny nz f_dc_0..2 f_rest_0.. opacity scale_0..2 rot_0..3`. `f_rest` holds all
coefficients of red, then green, then blue, `opacity` is a logit, `scale` a natural logarithm and `rot` a quaternion
(w, x, y, z). All are written as float32; only `x y z` of geo-referenced scenes are float64, and a comment has the
origin. `filter_3D` of Mip-Splatting is the standard deviation of a filter, which is applied while reading.
"""

import hashlib
import logging
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError, InvalidValueError
from splatwire.files.whole import written_whole
from splatwire.formats._columns import MAX_LOG_SCALE, build_splats, check_count, filled
from splatwire.formats.content import FileContent
from splatwire.formats.ply_comments import (
    ORIGIN,
    antialiasing_comments,
    origin_comments,
    stated_origin,
    states_antialiasing,
)
from splatwire.formats.ply_file import PlyElement
from splatwire.formats.ply_metadata import metadata_comments, stated_metadata
from splatwire.formats.ply_note import DIGEST_DIGITS, PlyNote, marked
from splatwire.ops.spherical_harmonics import MAX_DEGREE, degree_of, num_functions
from splatwire.scene.metadata import NO_METADATA, SceneMetadata
from splatwire.scene.origin import NO_ORIGIN, Origin, choose_origin
from splatwire.scene.splats import ROWS, Splats

LOG = logging.getLogger(__name__)
_REST_OF_4 = 72
"""Properties `f_rest_*` of harmonics of degree 4."""
_AXES = ("x", "y", "z")
_COUNT_DIGITS = 12
_MIN_OPACITY = 1e-6
"""Opacities are kept this far from 0 and 1, where the logit is infinite."""


def content_of_vertices(vertices: PlyElement) -> FileContent:
    """Makes Gaussians of the vertices of a 3DGS PLY.

    Normals and properties of other names are ignored; quaternions are normalised. The origin is that of the comments,
    or one near the Gaussians if they are far from 0; it is subtracted in float64.

    Raises:
        DatasetError: If a property is missing, or numbers are no Gaussian.
    """
    path = vertices.path
    check_count(path, len(vertices.rows), vertices.rows.nbytes)
    if vertices.count_of("scale_") != 3:
        count = vertices.count_of("scale_")
        hint = "; a PLY of anchors is read by `splatwire import scaffold` or `hacpp`" if count == 6 else ""
        raise DatasetError(f"{path}: has {count} properties scale_*, explicit Gaussians have 3{hint}")
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
    splats, origin = Splats.empty(len(vertices.rows), degree), _origin(vertices)
    for begin in range(0, len(vertices.rows), ROWS):
        splats.fill(begin, _some(replace(vertices, rows=vertices.rows[begin : begin + ROWS]), num_rest, origin))
    metadata = stated_metadata(vertices.comments).moved_origin(NO_ORIGIN, origin)
    return FileContent(splats, origin, states_antialiasing(vertices.comments), metadata)


def _origin(vertices: PlyElement) -> Origin:
    stated = stated_origin(ORIGIN, vertices.comments)
    if stated is not None:
        return stated
    some = replace(vertices, rows=vertices.rows[:: max(1, -(-len(vertices.rows) // ROWS))])
    wide = any(vertices.rows.dtype[name] != np.float32 for name in _AXES if name in vertices.names)
    return choose_origin(some.select_wide(list(_AXES)), wide=wide)


def _some(vertices: PlyElement, num_rest: int, origin: Origin) -> Splats:
    harmonics = [vertices.columns("f_dc_", 3)[:, None]]
    if num_rest:
        rest = vertices.columns("f_rest_", num_rest)
        harmonics.append(rest.reshape(len(rest), 3, -1).transpose(0, 2, 1)[:, : num_functions(MAX_DEGREE) - 1])
    log_scales, opacities = vertices.columns("scale_", 3), _expit(vertices.select(["opacity"])[:, 0])
    if filters := [name for name in vertices.names if name.lower() == "filter_3d"]:
        log_scales, opacities = _filtered(log_scales, opacities, vertices.select_wide(filters[:1]))
    return build_splats(
        vertices.path,
        means=vertices.select_wide(list(_AXES)) - np.array(origin),
        quats=vertices.columns("rot_", 4),
        log_scales=log_scales,
        opacities=opacities,
        sh=np.concatenate(harmonics, axis=1),
    )


def _filtered(log_scales: np.ndarray, opacities: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Applies the 3D smoothing filter of Mip-Splatting (Yu et al., CVPR 2024, equation 9).

    Args:
        log_scales: float32 (N, 3), logarithms of standard deviations.
        opacities: float32 (N).
        sizes: Standard deviation of the filter of each, float64 (N, 1).

    Returns:
        Logarithms of the standard deviations of the convolution, and opacities times the root of the ratio of the
        covariances' determinants.
    """
    logs = np.maximum(log_scales.astype(np.float64), -MAX_LOG_SCALE)
    with np.errstate(divide="ignore"):
        wider = np.logaddexp(2 * logs, 2 * np.log(np.abs(sizes))) / 2
    return wider.astype(np.float32), (opacities * np.exp((logs - wider).sum(axis=1))).astype(np.float32)


def _expit(logits: np.ndarray) -> np.ndarray:
    """`scipy.special.expit` in float32, but for a last digit in 4,000: to load that package takes 0.3 s."""
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-logits.astype(np.float64)).astype(np.float32))


def write_ply(
    parts: Iterable[Splats],
    path: Path,
    note: PlyNote | None = None,
    *,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    metadata: SceneMetadata = NO_METADATA,
) -> int:
    """Writes Gaussians part by part, so that they never have to be in memory together.

    Normals are written as 0, opacities are kept a millionth from 0 and 1. With an origin, positions are written as
    float64 world coordinates. See `splatwire.formats.write_splats`.
    """
    count, degree, digest = 0, 0, hashlib.sha256()
    remarks = antialiasing_comments(antialiased) + origin_comments(ORIGIN, origin)
    remarks += metadata_comments(metadata.moved_origin(origin, NO_ORIGIN))
    with written_whole(path) as unfinished, unfinished.open("wb") as file:
        for part in filled(path, parts):
            if not count:
                degree = part.degree
                file.write(_header(0, degree, note, digest.hexdigest(), remarks, origin))
            rows, end = _rows(part), count + part.num_gaussians
            rows = rows if note is None else marked(rows, note.marks[count:end])
            data = _record_bytes(rows, origin)
            digest.update(data)
            file.write(data)
            count = end
        file.seek(0)
        file.write(_header(count, degree, note, digest.hexdigest(), remarks, origin))
    return count


def _record_bytes(rows: np.ndarray, origin: Origin) -> bytes:
    """Rows as they are written: float32, positions with an origin as float64 world coordinates."""
    if origin == NO_ORIGIN:
        return rows.astype("<f4").tobytes()
    records = np.empty(len(rows), [("means", "<f8", 3), ("rest", "<f4", rows.shape[1] - 3)])
    records["means"] = rows[:, :3] + np.array(origin)
    records["rest"] = rows[:, 3:]
    return records.tobytes()


def property_names(degree: int) -> list[str]:
    """Returns the names of the properties, in the order of the file."""
    rest = 3 * ((degree + 1) ** 2 - 1)
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(rest)),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def _header(count: int, degree: int, note: PlyNote | None, digest: str, remarks: list[str], origin: Origin) -> bytes:
    """The header; a comment fills it up, so that it is equally long whatever the count."""
    digits = str(count)
    lines = ["ply", "format binary_little_endian 1.0", "comment splatwire" + "." * (_COUNT_DIGITS - len(digits))]
    lines += [] if note is None else [note.line(digest[:DIGEST_DIGITS])]
    lines += [f"comment {remark}" for remark in remarks]
    wide = _AXES if origin != NO_ORIGIN else ()
    types = {name: "double" if name in wide else "float" for name in property_names(degree)}
    lines += [f"element vertex {digits}", *(f"property {kind} {name}" for name, kind in types.items())]
    return ("\n".join(lines) + "\nend_header\n").encode()


def _rows(part: Splats) -> np.ndarray:
    means, quats, scales, sh = part.means, part.quats, part.scales, part.sh
    opacities = np.clip(part.opacities.astype(np.float64), _MIN_OPACITY, 1 - _MIN_OPACITY)
    rest = sh[:, 1:].transpose(0, 2, 1).reshape(len(means), -1)
    logits = np.log(opacities / (1 - opacities))[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(scales)
    rows = np.concatenate([means, np.zeros_like(means), sh[:, 0], rest, logits, logs, quats], axis=1)
    if not np.isfinite(rows).all():
        raise InvalidValueError("a Gaussian has a number that is not finite, or a size that is not positive")
    return rows
