"""Reader of `.ksplat` files of GaussianSplats3D (github.com/mkkellogg/GaussianSplats3D), version 0.1; RDF axes.

A file has a header of 4096 bytes, 1024 bytes for the header of each possible section, and the sections. A section has
the sizes of its partially filled buckets (spatial groups of Gaussians), the centres of all buckets, and the Gaussians.

Colours and opacities have 8 bits. Other values have 32 bits at compression level 0, and 16 bits at levels 1 and 2;
level 2 has spherical harmonics in 8 bits. Positions of 16 bits are relative to the centre of the bucket.
"""

import logging
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.kinds import format_error
from splatwire.io.formats._columns import build_splats, check_count
from splatwire.io.formats._files import FileBytes, warn_of_bytes_outside
from splatwire.ops.spherical_harmonics import DC, num_functions
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
_HEADER_BYTES, _SECTION_BYTES = 4096, 1024
_MAX_SECTIONS, _MAX_DEGREE, _MAX_LEVEL = 4096, 2, 2
_SECTION = struct.Struct("<4IfH2x4IH")
_MINOR = 1
_DEFAULT_RANGE = 32767
_DEFAULT_HARMONICS = 1.5


def _record(compression_level: int, degree: int) -> np.dtype:
    wide, rest = ("<f4", "<f4") if compression_level == 0 else ("<u2", "<f2"), 3 * (num_functions(degree) - 1)
    position, number = wide
    fields = [("position", position, 3), ("scale", number, 3), ("rotation", number, 4), ("color", "u1", 4)]
    if rest:
        fields.append(("harmonics", ("<f4", "<f2", "u1")[compression_level], rest))
    return np.dtype(fields)


@dataclass(frozen=True)
class _Section:
    """Parsed header of one section of a `.ksplat` file.

    The Gaussians of a section are grouped in buckets; compressed positions are relative to the bucket's centre.

    Attributes:
        count: Number of Gaussians.
        capacity: Number of Gaussians for which the section has space.
        bucket_size: Number of Gaussians in a full bucket.
        buckets: Number of buckets.
        block_size: Edge length of the cube that a bucket covers, world units.
        bucket_bytes: Bytes per bucket centre.
        range: 16-bit position code of the bucket's centre. The codes 0 and `2 * range` are the ends of the bucket along
            an axis. A `range` of 0 stands for the default, 32767.
        num_bytes: Size of the section in bytes; 0 if not stated.
        full: Number of full buckets.
        partial: Number of partially filled buckets.
        degree: Degree of the spherical harmonics.
    """

    count: int
    capacity: int
    bucket_size: int
    buckets: int
    block_size: float
    bucket_bytes: int
    range: int
    num_bytes: int
    full: int
    partial: int
    degree: int


def read_ksplat(path: Path) -> Splats:
    """Reads a `.ksplat` file.

    Raises:
        DatasetError: If the file is damaged or of another format.
        OSError: If the file cannot be read.
    """
    data = FileBytes(path)
    head = data[:_HEADER_BYTES]
    if len(data) < _HEADER_BYTES + _SECTION_BYTES or head[0] != 0 or not 1 <= head[1] < 10:
        why = f"{len(data)} bytes, and {list(head[:2])} is its version"
        raise DatasetError(format_error(path, "a .ksplat file of version 0.1", why))
    max_sections, num_sections, _, count, level = struct.unpack_from("<IIIIH", head, 4)
    check_count(path, count, len(data))
    # GaussForge writes 0 as the number of sections; like viewers, the reader relies on the maximum
    if not num_sections <= max_sections or not 0 < max_sections <= _MAX_SECTIONS or level > _MAX_LEVEL:
        raise DatasetError(f"{path}: {num_sections} of {max_sections} sections, compression level {level}: impossible")
    low, high = (float(value) for value in struct.unpack_from("<ff", head, 36))
    bounds = (low or -_DEFAULT_HARMONICS, high or _DEFAULT_HARMONICS)
    if level == _MAX_LEVEL and not bounds[0] < bounds[1]:
        raise DatasetError(f"{path}: harmonics from {bounds[0]:g} to {bounds[1]:g}: the bounds are swapped or damaged")
    if head[1] != _MINOR:
        LOG.warning("%s: .ksplat of version 0.%d is not known: it is read as version 0.%d", path, head[1], _MINOR)
    offset = _HEADER_BYTES + max_sections * _SECTION_BYTES
    if offset > len(data):
        raise DatasetError(f"{path}: {max_sections} sections do not fit into {len(data)} bytes")
    parts: list[dict[str, np.ndarray]] = []
    for index in range(max_sections):
        section = _parse_section(path, data, index)
        part, offset = _read_section(path, data, offset, section, level, bounds)
        if section.count:
            parts.append(part)
    if (num_read := sum(len(part["means"]) for part in parts)) != count:
        raise DatasetError(f"{path}: the sections have {num_read} Gaussians, the header says {count}")
    warn_of_bytes_outside(path, len(data) - offset)
    width = max(part["sh"].shape[1] for part in parts)
    for part in parts:
        part["sh"] = np.pad(part["sh"], ((0, 0), (0, width - part["sh"].shape[1]), (0, 0)))
    return build_splats(path, **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def _parse_section(path: Path, data: FileBytes, index: int) -> _Section:
    offset = _HEADER_BYTES + index * _SECTION_BYTES
    section = _Section(*_SECTION.unpack_from(data[offset : offset + _SECTION_BYTES]))
    if section.degree > _MAX_DEGREE:
        raise DatasetError(f"{path}: section {index} has harmonics of degree {section.degree}, not 0 to {_MAX_DEGREE}")
    if section.count > section.capacity or section.partial + section.full > max(section.buckets, 0):
        raise DatasetError(f"{path}: section {index} has more Gaussians or buckets than room for them")
    return section


def _read_section(
    path: Path, data: FileBytes, offset: int, section: _Section, compression_level: int, bounds: tuple[float, float]
) -> tuple[dict[str, np.ndarray], int]:
    record = _record(compression_level, section.degree)
    centers_at = offset + 4 * section.partial
    rows_at = centers_at + section.bucket_bytes * section.buckets
    end = rows_at + record.itemsize * section.capacity
    if section.num_bytes not in (0, end - offset):
        raise DatasetError(
            f"{path}: a section has {section.num_bytes} bytes, but its {section.capacity} Gaussians with harmonics of "
            f"degree {section.degree} take {end - offset}: the file is damaged, or of another layout"
        )
    if end > len(data):
        raise DatasetError(f"{path}: a section of {section.capacity} Gaussians ends at byte {end} of {len(data)}")
    rows = np.frombuffer(data[rows_at : rows_at + record.itemsize * section.count], record)
    color = rows["color"].astype(np.float32) / 255
    sh = ((color[:, None, :3] - 0.5) / np.float32(DC)).astype(np.float32)
    if section.degree:
        sh = np.concatenate([sh, _harmonics(rows["harmonics"], compression_level, section.degree, bounds)], axis=1)
    means = rows["position"].astype(np.float32)
    if compression_level and section.count:
        means = _from_bucket(path, data, offset, centers_at, section, means)
    columns: dict[str, np.ndarray] = {
        "means": means,
        "sh": sh,
        "opacities": color[:, 3],
        "scales": rows["scale"],
        "quats": rows["rotation"],
    }
    return columns, end


def _from_bucket(
    path: Path, data: FileBytes, offset: int, centers_at: int, section: _Section, codes: np.ndarray
) -> np.ndarray:
    """Decodes 16-bit positions, which are relative to the centre of a spatial group of Gaussians (bucket).

    Args:
        path: The file, for messages.
        data: Content of the file.
        offset: Byte offset of the table of partially filled buckets, with the number of Gaussians in each.
        centers_at: Byte offset of the centres of the buckets.
        section: Header of the section.
        codes: 16-bit position codes, (N, 3).

    Returns:
        Positions, world units, (N, 3).
    """
    if section.bucket_bytes != 12:
        raise DatasetError(f"{path}: bucket centres of {section.bucket_bytes} bytes, 12 are read")
    sizes = np.frombuffer(data[offset : offset + 4 * section.partial], "<u4").astype(np.int64)
    in_full = section.full * section.bucket_size
    if in_full + int(sizes.sum()) < section.count:
        raise DatasetError(f"{path}: buckets for {in_full + int(sizes.sum())} of {section.count} Gaussians")
    row = np.arange(section.count)
    bucket = section.full + np.searchsorted(np.cumsum(sizes), row - in_full, side="right")
    bucket = np.where(row < in_full, row // max(section.bucket_size, 1), bucket)
    centers = np.frombuffer(data[centers_at : centers_at + 12 * section.buckets], "<f4").reshape(-1, 3)
    levels = section.range or _DEFAULT_RANGE
    return (codes - np.float32(levels)) * np.float32(section.block_size / 2 / levels) + centers[bucket]


def _harmonics(values: np.ndarray, compression_level: int, degree: int, bounds: tuple[float, float]) -> np.ndarray:
    numbers = values.astype(np.float32)
    if compression_level == 2:
        numbers = bounds[0] + numbers / np.float32(255) * np.float32(bounds[1] - bounds[0])
    bands, start = [], 0
    for band in range(1, degree + 1):  # order within a band: all red, then green, then blue
        width = 3 * (2 * band + 1)
        bands.append(numbers[:, start : start + width].reshape(len(values), 3, 2 * band + 1).transpose(0, 2, 1))
        start += width
    return np.concatenate(bands, axis=1)
