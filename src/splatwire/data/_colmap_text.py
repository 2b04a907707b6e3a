"""Reader of COLMAP's text files."""

import logging
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from splatwire.data._colmap_types import MODELS, RawCamera, RawImage
from splatwire.errors import DatasetError
from splatwire.files.kinds import format_error
from splatwire.files.read_limited import open_regular

LOG = logging.getLogger(__name__)
_MAX_LINE_BYTES = 1 << 26
_COUNT = re.compile(rb"#\s*Number of (?:cameras|images|points):\s*([0-9]{1,12})\b")
"""Pattern of the comment in which COLMAP states the number of entries of a file."""
_HEAD_BYTES = 4096
_MAX_WORDS = 20
"""Maximum number of fields that are read from a line of `cameras.txt`; the largest camera model has 16 parameters."""

_UNIT_TOLERANCE = 1e-3
"""Largest deviation of the length of a rotation from 1."""


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yields the line number and text of each line that is not a comment; skips a byte order mark."""
    with open_regular(path, DatasetError) as file:
        number = 0
        while raw := file.readline(_MAX_LINE_BYTES + 1):
            number += 1
            if len(raw) > _MAX_LINE_BYTES:
                raise DatasetError(f"{path}: line {number} does not end within {_MAX_LINE_BYTES:,} bytes")
            try:
                line = raw.decode("utf-8-sig" if number == 1 else "utf-8").strip()
            except UnicodeDecodeError as error:
                raise DatasetError(format_error(path, "UTF-8 text")) from error
            if not line.startswith("#"):
                yield number, line


def _warn_of_missing_entries(path: Path, count: int) -> None:
    """Logs a warning if the number of entries in a text file differs from the number in its header.

    Args:
        path: The file.
        count: Number of entries that were read.
    """
    stated = _stated_count(path)
    if stated not in (None, count):
        LOG.warning(
            "%s: has %s entries, and its header states %s: the file may be cut", path, f"{count:,}", f"{stated:,}"
        )


def _stated_count(path: Path) -> int | None:
    """Returns the number of entries that the header of a text file states; None if it states none."""
    with open_regular(path, DatasetError) as file:
        stated = _COUNT.search(file.read(_HEAD_BYTES))
    return None if stated is None else int(stated[1])


def read_cameras(path: Path) -> list[RawCamera]:
    """Reads `cameras.txt`."""
    models = dict(MODELS)
    cameras = []
    for number, line in _lines(path):
        words = line.split(maxsplit=_MAX_WORDS)
        if not words:
            continue
        try:
            camera_id, model, width, height = int(words[0]), words[1], int(words[2]), int(words[3])
            parameters = tuple(float(word) for word in words[4:])
        except (IndexError, ValueError) as error:
            raise DatasetError(f"{path}: line {number} is not a camera: {line[:80]!r}") from error
        if models.get(model) != len(parameters):
            raise DatasetError(f"{path}: line {number}: unknown camera model {model} with {len(parameters)} parameters")
        cameras.append(RawCamera(camera_id, model, width, height, parameters))
    _warn_of_missing_entries(path, len(cameras))
    return cameras


def read_images(path: Path) -> list[RawImage]:
    """Reads `images.txt`; the lines of 2D points are skipped.

    Raises:
        DatasetError: If a line is neither an image nor the 2D points of the image above it.
    """
    images: list[RawImage] = []
    points_may_follow = False
    for number, line in _lines(path):
        if points_may_follow and _is_points(line) and not _has_pose(line):
            points_may_follow = False
        elif line:
            images.append(_image(path, number, line))
            points_may_follow = True
    _warn_of_missing_entries(path, len(images))
    return images


def count_images(path: Path) -> int:
    """Returns the number of images that the header of `images.txt` states; reads the images if it states none."""
    stated = _stated_count(path)
    return len(read_images(path)) if stated is None else stated


def _image(path: Path, number: int, line: str) -> RawImage:
    words = line.split(maxsplit=9)
    try:
        int(words[0])
        pose = tuple(float(word) for word in words[1:8])
        return RawImage(words[9], int(words[8]), pose[:4], pose[4:])
    except (IndexError, ValueError) as error:
        raise DatasetError(f"{path}: line {number} is not an image: {line[:80]!r}") from error


def _is_points(line: str) -> bool:
    """True for a line of 2D points: triples of x, y and 3D point id, or an empty line."""
    words = line.split()
    return len(words) % 3 == 0 and all(map(_is_number, (*words[:12], *words[-1:])))


def _has_pose(line: str) -> bool:
    """True if a line of numbers in `images.txt` describes an image with its pose; False for a line of 2D points."""
    words = line.split(maxsplit=9)
    if len(words) < 10 or not words[0].isdecimal() or not words[8].isdecimal():
        return False
    # An image has a quaternion of length 1 here, points have coordinates and an id; the file name after these numbers
    # may also consist of numbers, such as `12 34 56`.
    return abs(math.hypot(*map(float, words[1:5])) - 1) < _UNIT_TOLERANCE


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_points3d(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Reads `points3D.txt`: float64 (P, 3) positions and uint8 (P, 3) colours."""
    positions, colors = [], []
    for number, line in _lines(path):
        words = line.split(maxsplit=7)
        if not words:
            continue
        try:
            positions.append([float(word) for word in words[1:4]])
            colors.append([int(word) for word in words[4:7]])
            if len(words) < 7 or not all(0 <= value <= 255 for value in colors[-1]):
                raise ValueError(line)
        except ValueError as error:
            raise DatasetError(f"{path}: line {number} is not a point: {line[:80]!r}") from error
    _warn_of_missing_entries(path, len(positions))
    return np.array(positions, dtype=np.float64).reshape(-1, 3), np.array(colors, dtype=np.uint8).reshape(-1, 3)
