"""Reader of COLMAP's binary files; record counts are checked against the file size."""

import io
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from splatwire.data._colmap_types import MODELS, RawCamera, RawImage
from splatwire.errors import DatasetError
from splatwire.files.read_limited import open_regular

_MAX_NAME_BYTES = 4096
_MIN_IMAGE_BYTES = 73
_MIN_CAMERA_BYTES = 24 + 8 * min(count for _, count in MODELS)


class _Cursor:
    """Sequential reader of the records of a binary file."""

    def __init__(self, path: Path, file: io.BufferedIOBase) -> None:
        self.path = path
        self._file = file
        self.size = file.seek(0, io.SEEK_END)
        self.offset = file.seek(0)

    def take(self, layout: str) -> tuple:
        form = struct.Struct("<" + layout)
        self._need(form.size)
        self.offset += form.size
        return form.unpack(self._file.read(form.size))

    def skip(self, num_bytes: int) -> None:
        self._need(num_bytes)
        self.offset = self._file.seek(self.offset + num_bytes)

    def count(self, min_record_bytes: int) -> int:
        (count,) = self.take("Q")
        if count * min_record_bytes > self.size - self.offset:
            raise DatasetError(f"{self.path}: promises {count} records, more than its {self.size} bytes can hold")
        return int(count)

    def name(self) -> str:
        raw, zero, _ = self._file.read(_MAX_NAME_BYTES).partition(b"\0")
        if not zero:
            raise DatasetError(f"{self.path}: an image name at byte {self.offset} does not end")
        try:
            name = raw.decode("utf-8")
        except UnicodeDecodeError as error:
            raise DatasetError(f"{self.path}: an image name at byte {self.offset} is not UTF-8") from error
        self.offset = self._file.seek(self.offset + len(raw) + 1)
        return name

    def finish(self) -> None:
        if self.offset != self.size:
            raise DatasetError(f"{self.path}: {self.size - self.offset} bytes after the last record")

    def _need(self, num_bytes: int) -> None:
        if num_bytes > self.size - self.offset:
            raise DatasetError(f"{self.path}: ends early, at byte {self.size}")


@contextmanager
def _opened(path: Path) -> Iterator[_Cursor]:
    with open_regular(path, DatasetError) as file:
        cursor = _Cursor(path, file)
        yield cursor
        cursor.finish()


def read_cameras(path: Path) -> list[RawCamera]:
    """Reads `cameras.bin`."""
    cameras = []
    with _opened(path) as cursor:
        for _ in range(cursor.count(_MIN_CAMERA_BYTES)):
            camera_id, model, width, height = cursor.take("IiQQ")
            if not 0 <= model < len(MODELS):
                raise DatasetError(f"{path}: camera {camera_id} is of an unknown model, number {model}")
            name, num_parameters = MODELS[model]
            cameras.append(RawCamera(camera_id, name, width, height, cursor.take(f"{num_parameters}d")))
    return cameras


def read_images(path: Path) -> list[RawImage]:
    """Reads `images.bin`; the 2D points are skipped."""
    images = []
    with _opened(path) as cursor:
        for _ in range(cursor.count(_MIN_IMAGE_BYTES)):
            _, *pose, camera_id = cursor.take("I7dI")
            name = cursor.name()
            cursor.skip(24 * cursor.count(24))
            images.append(RawImage(name, camera_id, tuple(pose[:4]), tuple(pose[4:])))
    return images


def count_images(path: Path) -> int:
    """Returns the number of images that the header of `images.bin` states; the images are not read."""
    with open_regular(path, DatasetError) as file:
        return _Cursor(path, file).count(_MIN_IMAGE_BYTES)


def read_points3d(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Reads `points3D.bin`: float64 (P, 3) positions and uint8 (P, 3) colours."""
    with _opened(path) as cursor:
        count = cursor.count(51)
        positions, colors = np.empty((count, 3)), np.empty((count, 3), dtype=np.uint8)
        for i in range(count):
            values = cursor.take("Q3d3Bd")
            positions[i], colors[i] = values[1:4], values[4:7]
            cursor.skip(8 * cursor.count(8))
    return positions, colors
