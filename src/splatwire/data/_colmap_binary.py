"""COLMAP's binary files. Counts are believed only as far as the bytes go."""

import struct
from pathlib import Path

import numpy as np

from splatwire.data._colmap_types import MODELS, RawCamera, RawImage
from splatwire.errors import DatasetError

_MAX_NAME_BYTES = 4096


class _Cursor:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.data = path.read_bytes()
        self.offset = 0

    def take(self, layout: str) -> tuple:
        form = "<" + layout
        if self.offset + struct.calcsize(form) > len(self.data):
            raise DatasetError(f"{self.path}: ends early, at byte {len(self.data)}")
        values = struct.unpack_from(form, self.data, self.offset)
        self.offset += struct.calcsize(form)
        return values

    def skip(self, num_bytes: int) -> None:
        if num_bytes > len(self.data) - self.offset:
            raise DatasetError(f"{self.path}: ends early, at byte {len(self.data)}")
        self.offset += num_bytes

    def count(self, min_record_bytes: int) -> int:
        (count,) = self.take("Q")
        if count * min_record_bytes > len(self.data) - self.offset:
            raise DatasetError(f"{self.path}: promises {count} records, more than its {len(self.data)} bytes can hold")
        return int(count)

    def name(self) -> str:
        end = self.data.find(b"\0", self.offset, self.offset + _MAX_NAME_BYTES)
        if end < 0:
            raise DatasetError(f"{self.path}: an image name at byte {self.offset} does not end")
        raw, self.offset = self.data[self.offset : end], end + 1
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError as error:
            raise DatasetError(f"{self.path}: an image name at byte {self.offset} is not UTF-8") from error

    def finish(self) -> None:
        if self.offset != len(self.data):
            raise DatasetError(f"{self.path}: {len(self.data) - self.offset} bytes after the last record")


def read_cameras(path: Path) -> list[RawCamera]:
    """Reads `cameras.bin`."""
    cursor = _Cursor(path)
    cameras = []
    for _ in range(cursor.count(48)):
        camera_id, model, width, height = cursor.take("IiQQ")
        if not 0 <= model < len(MODELS):
            raise DatasetError(f"{path}: camera {camera_id} is of an unknown model, number {model}")
        name, num_parameters = MODELS[model]
        cameras.append(RawCamera(camera_id, name, width, height, cursor.take(f"{num_parameters}d")))
    cursor.finish()
    return cameras


def read_images(path: Path) -> list[RawImage]:
    """Reads `images.bin`; the 2D points are skipped."""
    cursor = _Cursor(path)
    images = []
    for _ in range(cursor.count(73)):
        _, *pose, camera_id = cursor.take("I7dI")
        name = cursor.name()
        cursor.skip(24 * cursor.count(24))
        images.append(RawImage(name, camera_id, tuple(pose[:4]), tuple(pose[4:])))
    cursor.finish()
    return images


def read_points3d(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Reads `points3D.bin`: float64 (P, 3) positions and uint8 (P, 3) colours."""
    cursor = _Cursor(path)
    count = cursor.count(51)
    positions, colors = np.empty((count, 3)), np.empty((count, 3), dtype=np.uint8)
    for i in range(count):
        values = cursor.take("Q3d3Bd")
        positions[i], colors[i] = values[1:4], values[4:7]
        cursor.skip(8 * cursor.count(8))
    cursor.finish()
    return positions, colors
