"""`.splat` files: 32 bytes per Gaussian, view-independent colour; axes are RDF (right, down, forward)."""

import logging
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.atomic_write import atomic_output
from splatwire.files.read_limited import open_regular
from splatwire.io.formats._columns import build_splats, check_count, checked_batches, rounded_bytes
from splatwire.io.formats.outliers import warn_of_clipped
from splatwire.ops.spherical_harmonics import DC
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
_EXTREME = 1e30
"""Limit of plausible positions and sizes; the inverse is the lower limit."""
RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)])


def read_splat(path: Path) -> Splats:
    """Reads a `.splat` file; the harmonics are of degree 0.

    Raises:
        DatasetError: If its size is not a multiple of 32 bytes, or most of its records are not plausible Gaussians.
        OSError: If the file cannot be read.
    """
    size = path.stat().st_size
    if not size or size % RECORD.itemsize:
        raise DatasetError(f"{path}: {size} bytes are not records of {RECORD.itemsize} bytes")
    with open_regular(path, DatasetError) as file:
        records = np.fromfile(file, RECORD, check_count(path, size // RECORD.itemsize, size))
    odd = _num_implausible(records)
    if odd > len(records) // 2:
        raise DatasetError(
            f"{path}: {odd:,} of {len(records):,} records of {RECORD.itemsize} bytes have impossible positions or "
            "sizes of Gaussians: the file is of another format than its name says"
        )
    color = records["color"].astype(np.float32) / 255
    return build_splats(
        path,
        means=records["position"],
        quats=records["rotation"].astype(np.float32) / 128 - 1,
        scales=records["scale"],
        opacities=color[:, 3],
        sh=(color[:, None, :3] - 0.5) / np.float32(DC),
    )


def _num_implausible(records: np.ndarray) -> int:
    """Counts the records with implausible positions or scales. Many such records show that a file has another format.

    The `.splat` format has no signature. If a file of another format is read as `.splat`, the numbers are often
    negative, not finite, or of an extreme magnitude. Scales close to 0 are plausible, because Gaussians may be flat.
    """
    with np.errstate(invalid="ignore"):
        distances, scales = np.abs(records["position"]), records["scale"]
        usual = ((distances > 1 / _EXTREME) & (distances < _EXTREME)) | (distances == 0)
        positive = (scales >= 0) & (scales < _EXTREME)
        return int((~usual | ~positive).any(axis=1).sum())


def write_splat(parts: Iterable[Splats], path: Path) -> int:
    """Writes a `.splat` file batch by batch; returns the number of Gaussians.

    Positions and scales are stored as float32; colours, opacities and rotations as bytes. The format has one colour for
    all directions, so that only spherical harmonics of degree 0 are stored.

    Args:
        parts: Batches of Gaussians, all of one degree of spherical harmonics.
        path: Path of the file, written atomically.
    """
    count, degree, colours = write_records(parts, path)
    if degree:
        LOG.warning(
            "%s: a .splat file has one colour for all directions; the scene's harmonics, of degree %d, are not in it",
            path, degree,
        )  # fmt: skip
    warn_of_clipped(path, "base colours", colours, 0.0, 1.0)
    return count


def write_records(parts: Iterable[Splats], path: Path) -> tuple[int, int, np.ndarray]:
    """Writes a `.splat` file as `write_splat` does, but without warnings.

    Returns:
        Number of Gaussians; degree of their harmonics; and the largest channel of each base colour, at least 0, (N).
    """
    count, degree, colours = 0, 0, []
    with atomic_output(path) as unfinished, unfinished.open("wb") as file:
        for part in checked_batches(path, parts):
            file.write(_records(part).tobytes())
            count, degree = count + part.num_gaussians, part.degree
            colours.append((0.5 + DC * part.sh[:, 0]).max(axis=1).clip(min=0))  # renderers clip at 0, too
    return count, degree, np.concatenate(colours)


def _records(part: Splats) -> np.ndarray:
    tensors = (part.means, part.scales, part.sh[:, 0], part.opacities, part.quats)
    means, scales, constant, opacities, quats = (t for t in tensors)
    records = np.empty(part.num_gaussians, dtype=RECORD)
    records["position"], records["scale"] = means, scales
    records["color"][:, :3] = rounded_bytes(255 * (0.5 + DC * constant))
    records["color"][:, 3] = rounded_bytes(255 * opacities)
    records["rotation"] = rounded_bytes(128 * quats + 128)
    return records
