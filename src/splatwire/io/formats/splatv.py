"""`.splatv` files: Gaussians on polynomial paths through time, as trained by SpacetimeGaussians and played by splaTV.

A file begins with a magic number, the size of a JSON list, and the list, which describes the data blocks after it. The
block of type `splat` has 64 bytes per Gaussian:

* position (3 float32);
* rotation w, x, y, z (4 float16), sizes (3 float16), padding (2 bytes);
* red, green, blue, opacity (4 bytes);
* coefficients of the position for t, t^2 and t^3 (9 float16), padding (2 bytes);
* coefficients of the rotation for t (4 float16);
* time of highest opacity, duration of visibility (2 float16).

Times are 0 to 1; t is the current time minus the time of highest opacity.
"""

import json
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.arguments import CheckedFields, checked
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.files.read_limited import open_regular
from splatwire.io.formats._columns import build_splats, check_count
from splatwire.ops.spherical_harmonics import DC
from splatwire.reprs import summary_repr
from splatwire.types.splats import Splats

MAGIC = b"\x4b\x67\0\0"
RECORD = np.dtype([
    ("place", "<f4", 3), ("rotation", "<f2", 4), ("scale", "<f2", 3), ("_", "<f2"), ("color", "u1", 4),
    ("motion", "<f2", (3, 3)), ("_2", "<f2"), ("turning", "<f2", 4), ("center", "<f2"), ("width", "<f2"),
])  # fmt: skip
MAX_HEAD_BYTES = 1 << 20
UNSEEN = 0.02
"""Minimum temporal factor on the opacity for a Gaussian to be drawn, as in splaTV."""


@dataclass(frozen=True, eq=False)
class MovingSplats(CheckedFields):
    """Gaussians that move along polynomial paths over time.

    Attributes:
        path: The file, for messages.
        records: Parameters of the Gaussians' paths, structured array of type `RECORD`, (N).
    """

    path: Path
    records: np.ndarray

    __repr__ = summary_repr

    def at(self, time: float) -> Splats:
        """Returns the Gaussians at a time from 0 (start of the sequence) to 1 (end).

        Gaussians that do not exist at that time have opacity 0.

        Raises:
            InvalidValueError: If the time is out of range.
        """
        if not 0 <= time <= 1:
            raise InvalidValueError(f"{self.path}: its time goes from 0 to 1, there is no {time}")
        records = self.records
        with np.errstate(all="ignore"):  # invalid values become NaN and are reported with the rows
            since = np.float32(time) - records["center"].astype(np.float32)
            powers = np.stack([since, since**2, since**3], axis=1)
            window = np.exp(-((since / records["width"].astype(np.float32)) ** 2))
            means = records["place"] + np.einsum("np,npc->nc", powers, records["motion"].astype(np.float32))
            quats = records["rotation"].astype(np.float32) + since[:, None] * records["turning"].astype(np.float32)
        color = records["color"].astype(np.float32) / 255
        return build_splats(
            self.path, means=means, quats=quats, scales=records["scale"].astype(np.float32),
            opacities=np.where(window >= UNSEEN, window, 0) * color[:, 3],
            sh=(color[:, None, :3] - 0.5) / np.float32(DC),
        )  # fmt: skip


@checked
def read_splatv(path: Path) -> MovingSplats:
    """Reads a `.splatv` file as Gaussians with harmonics of degree 0.

    Raises:
        DatasetError: If the file is truncated or of another format.
        OSError: If the file cannot be read.
    """
    size = path.stat().st_size
    with open_regular(path, DatasetError) as file:
        head = file.read(8)
        if head[:4] != MAGIC or len(head) < 8:
            raise DatasetError(f"{path}: not a .splatv file")
        (length,) = struct.unpack("<I", head[4:])
        if length > min(MAX_HEAD_BYTES, size - 8):
            raise DatasetError(f"{path}: a list of {length} bytes in a file of {size}")
        skipped, num_bytes = _gaussian_block(path, file.read(length))
        begin = 8 + length + skipped
        if num_bytes % RECORD.itemsize or begin + num_bytes > size:
            raise DatasetError(
                f"{path}: cut, or not {RECORD.itemsize} bytes a Gaussian: {num_bytes} of {size - begin} bytes"
            )
        file.seek(begin)
        records = np.fromfile(file, RECORD, check_count(path, num_bytes // RECORD.itemsize, size))
    used = records.view(np.uint8).reshape(len(records), -1).any(axis=1)  # a texture's last line is padded
    if not used.any():
        raise DatasetError(f"{path}: no Gaussian is in it")
    return MovingSplats(path, records[used])


def _gaussian_block(path: Path, data: bytes) -> tuple[int, int]:
    """Returns position and size of the data block with the Gaussians in the file, bytes."""
    try:
        pieces, before = json.loads(data), 0
        for piece in pieces:
            kind, size = piece["type"], piece["size"]
            if type(size) is not int or not 0 <= size < 1 << 40:
                break
            if kind == "splat":
                return before, size
            before += size
    except (ValueError, RecursionError, TypeError, KeyError):
        pass
    raise DatasetError(f"{path}: its list names no piece with Gaussians")
