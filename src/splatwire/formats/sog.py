"""SOG (github.com/playcanvas/splat-transform): a `meta.json` and lossless WebP pictures, as folder or zip.

Pixel i of each picture is Gaussian i. Positions are 16 bits of sign(x) log(1 + |x|) between bounds, rotations the
smallest three of w, x, y, z in 8 bits each, scales, colours and harmonics entries of code books with 256 numbers.
Harmonics are entries of a palette. Axes are RDF.

Version 1 has no field `version`. Bounds of each channel take the place of code books, the fourth channel of `sh0` is
the logit of the opacity, and the width of the palette's picture says the degree.
"""

import contextlib
import io
import json
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from splatwire.errors import DatasetError
from splatwire.files.archive import open_archive
from splatwire.files.kinds import SOG_LEVELS_NAME, SOG_META_NAME
from splatwire.formats._asset import metadata_of_asset
from splatwire.formats._columns import build_splats, check_count
from splatwire.formats.content import FileContent
from splatwire.ops.spherical_harmonics import MAX_DEGREE, num_functions
from splatwire.scene.splats import Splats

PALETTE_COLUMNS = 64
CODES = 256
_MAX_META_BYTES = 1 << 20
_MAX_PALETTE = 1 << 16
_SPARE_PIXELS = 1 << 16
_PICTURE_BYTES, _SPARE_BYTES = 5, 1 << 16
"""Most bytes of a picture: each pixel needs 4, and what cannot be packed becomes a little larger."""
_ROWS = 1 << 16
_MAX_LOG_POSITION = 40.0
_MAX_CODE = 1e6
_CHANNEL = np.float32(255)
"""Largest value of a channel of a picture."""


def read_sog(path: Path) -> FileContent:
    """Reads a bundled `.sog`, a folder with a `meta.json`, or that file.

    Raises:
        DatasetError: If something is missing, damaged, of another version, or of another size than it must be.
        OSError: If a file cannot be read.
    """
    with _opened(path) as found:
        return FileContent(
            found.splats(),
            antialiased=found.meta.get("antialias") is True,
            metadata=metadata_of_asset(found.meta.get("asset")),
        )


def is_antialiased(path: Path) -> bool:
    """True if a SOG, which can be read, says that it was trained with antialiasing."""
    with _opened(path) as found:
        return found.meta.get("antialias") is True


def read_asset(path: Path) -> object:
    """The `asset` of a SOG, which can be read; None if it has none."""
    with _opened(path) as found:
        return found.meta.get("asset")


@contextlib.contextmanager
def _opened(path: Path) -> "Iterator[_Sog]":
    if path.is_dir() or path.name == SOG_META_NAME:
        folder = path if path.is_dir() else path.parent
        names = {entry.name: entry.stat().st_size for entry in folder.iterdir() if entry.is_file()}
        yield _Sog(path, names, sum(names.values()), lambda name: (folder / name).read_bytes())
        return
    with open_archive(path, DatasetError) as bundle:
        prefix = _folder_of(path, bundle.sizes)
        names = {name[len(prefix) :]: size for name, size in bundle.sizes.items() if name.startswith(prefix)}
        yield _Sog(path, names, path.stat().st_size, lambda name: bundle.read(prefix + name, names[name]))


def _folder_of(path: Path, names: Iterable[str]) -> str:
    """Folder of an archive that has the `meta.json`, with its slash; empty where that lies outside of folders.

    Raises:
        DatasetError: If there is no such folder, or several.
    """
    here = [PurePosixPath(name) for name in names]
    if SOG_META_NAME in names:
        return ""
    if any(name.name == SOG_LEVELS_NAME for name in here):
        raise DatasetError(f"{path}: an archive of a streamed SOG ({SOG_LEVELS_NAME}): unpack it and name its folder")
    found = [name.parent for name in here if name.name == SOG_META_NAME and name.parts[0] != "__MACOSX"]
    if len(found) > 1:
        raise DatasetError(f"{path}: {len(found)} folders in it have a {SOG_META_NAME}: unpack it and name one of them")
    if not found:
        raise DatasetError(f"{path}: {SOG_META_NAME} is missing")
    return f"{found[0]}/"


class _Sog:
    """One SOG, whatever holds its files."""

    def __init__(self, path: Path, sizes: dict[str, int], file_bytes: int, load: Callable[[str], bytes]) -> None:
        self._path, self._sizes, self._load = path, sizes, load
        self.meta = self._read_meta()
        version = self.meta.get("version", 1)
        if version not in (1, 2) or type(version) is not int:
            raise DatasetError(f"{path}: SOG of version {version!r:.20}; versions 1 and 2 are read")
        self._first = version == 1
        count = self._first_count() if self._first else self.meta.get("count")
        if type(count) is not int:  # true is an int, too
            raise DatasetError(f"{path}: {SOG_META_NAME}: count is {count!r:.40}, not a number of Gaussians")
        self._count = check_count(path, count, file_bytes)

    def _first_count(self) -> Any:
        """Number of Gaussians of version 1, the first number of a shape."""
        shape = self._field("means", "shape")
        return shape[0] if isinstance(shape, list) and shape else shape

    def _read_meta(self) -> dict[str, Any]:
        try:
            meta = json.loads(self._bytes(SOG_META_NAME, _MAX_META_BYTES))
        except (ValueError, RecursionError) as error:
            raise DatasetError(f"{self._path}: {SOG_META_NAME} is no JSON: {error}") from error
        if not isinstance(meta, dict):
            raise DatasetError(f"{self._path}: {SOG_META_NAME} is no JSON object")
        return meta

    def _bytes(self, name: str, limit: int) -> bytes:
        if name not in self._sizes:
            raise DatasetError(f"{self._path}: {name[:80]} is missing")
        if self._sizes[name] > limit:
            raise DatasetError(f"{self._path}: {name[:80]} has {self._sizes[name]} bytes, the limit is {limit}")
        return self._load(name)

    def splats(self) -> Splats:
        low, high = (self._pixels("means", file) for file in range(2))
        bounds = [self._numbers("means", side, 3, _MAX_LOG_POSITION).astype(np.float32) for side in ("mins", "maxs")]
        share = (low[:, :3] + np.float32(256) * high[:, :3]) / np.float32(65535)
        logs = bounds[0] + (bounds[1] - bounds[0]) * share
        colors, opacities = self._colors_first() if self._first else self._colors()
        return build_splats(
            self._path,
            means=np.sign(logs) * np.expm1(np.abs(logs)),
            quats=self._rotations(),
            log_scales=self._log_scales(),
            opacities=opacities,
            sh=self._harmonics(colors),
        )

    def _log_scales(self) -> np.ndarray:
        pixels = self._pixels("scales")[:, :3]
        return self._between("scales", pixels) if self._first else self._codebook("scales")[pixels]

    def _colors(self) -> tuple[np.ndarray, np.ndarray]:
        """Constant coefficients (N, 3) and opacities (N)."""
        pixels = self._pixels("sh0")
        return self._codebook("sh0")[pixels[:, :3]], pixels[:, 3] / _CHANNEL

    def _colors_first(self) -> tuple[np.ndarray, np.ndarray]:
        """The same of version 1."""
        values = self._between("sh0", self._pixels("sh0"))
        return values[:, :3], 1 / (1 + np.exp(-values[:, 3]))

    def _between(self, section: str, pixels: np.ndarray) -> np.ndarray:
        """Numbers of version 1: shares of the way between bounds of each channel, float32 (N, C)."""
        low, high = (self._numbers(section, side, pixels.shape[1], _MAX_CODE) for side in ("mins", "maxs"))
        return (low + (high - low) * (pixels / _CHANNEL)).astype(np.float32)

    def _rotations(self) -> np.ndarray:
        pixels = self._pixels("quats")
        largest = pixels[:, 3].astype(np.int64) - 252
        others = (pixels[:, :3] / np.float32(255) * 2 - 1) / np.float32(2**0.5)
        rest = np.sqrt(np.maximum(0, 1 - (others**2).sum(axis=1, keepdims=True)))
        places = np.array([[3, 0, 1, 2], [0, 3, 1, 2], [0, 1, 3, 2], [0, 1, 2, 3]])
        quats = np.take_along_axis(np.concatenate([others, rest], axis=1), places[np.maximum(largest, 0)], axis=1)
        return np.where(largest[:, None] < 0, np.float32(np.nan), quats)

    def _harmonics(self, constant: np.ndarray) -> np.ndarray:
        """Coefficients (N, D, 3), of which the constant ones are known."""
        if self.meta.get("shN") is None:
            return constant[:, None]
        bands, count = self._palette_size()
        if type(bands) is not int or not 1 <= bands <= MAX_DEGREE:
            raise DatasetError(f"{self._path}: {SOG_META_NAME}: shN.bands is {bands!r:.40}, not 1 to {MAX_DEGREE}")
        if type(count) is not int or not 0 < count <= _MAX_PALETTE:
            raise DatasetError(f"{self._path}: {SOG_META_NAME}: shN.count is {count!r:.40}, not 1 to {_MAX_PALETTE}")
        width = num_functions(bands) - 1
        rows = -(-count // PALETTE_COLUMNS)
        palette = self._picture("shN", 0, pixels=rows * PALETTE_COLUMNS * width, width=PALETTE_COLUMNS * width)
        labels = self._pixels("shN", 1).astype(np.int64)
        label = labels[:, 0] + 256 * labels[:, 1]
        codes, codebook = palette[:, :3].reshape(-1, width, 3), self._palette_codebook()
        whole = np.empty((self._count, 1 + width, 3), np.float32)
        whole[:, 0] = constant
        for start in range(0, self._count, _ROWS):  # a few rows at a time: entries are four times as large as codes
            whole[start : start + _ROWS, 1:] = codebook[codes[np.minimum(label[start : start + _ROWS], count - 1)]]
        whole[label >= count] = np.nan
        return whole

    def _palette_size(self) -> tuple[Any, Any]:
        """Degree of the harmonics and entries of the palette; of version 1 as the pictures say."""
        if not self._first:
            return self._field("shN", "bands"), self._field("shN", "count")
        labels = self._pixels("shN", 1).astype(np.int64)
        width = self._width("shN", 0)
        bands = next((n for n in range(1, MAX_DEGREE + 1) if PALETTE_COLUMNS * (num_functions(n) - 1) == width), width)
        return bands, int((labels[:, 0] + 256 * labels[:, 1]).max()) + 1

    def _palette_codebook(self) -> np.ndarray:
        """Numbers that the palette's channels stand for, float32 (256)."""
        if not self._first:
            return self._codebook("shN")
        low, high = (self._numbers("shN", side, None, _MAX_CODE) for side in ("mins", "maxs"))
        return (low + (high - low) * np.linspace(0, 1, CODES)).astype(np.float32)

    def _field(self, section: str, name: str) -> Any:
        content = self.meta.get(section)
        if not isinstance(content, dict) or name not in content:
            raise DatasetError(f"{self._path}: {SOG_META_NAME}: {section}.{name} is missing")
        return content[name]

    def _numbers(self, section: str, name: str, count: int | None, limit: float) -> np.ndarray:
        """So many numbers of a section, float64 (count), or one, float64 ()."""
        values = self._field(section, name)
        try:
            numbers = np.array(values, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            numbers = np.empty(0)
        if numbers.shape != (() if count is None else (count,)) or not (np.abs(numbers) <= limit).all():
            raise DatasetError(
                f"{self._path}: {SOG_META_NAME}: {section}.{name} is not {count or 1} numbers within {limit:g}"
            )
        return numbers

    def _codebook(self, section: str) -> np.ndarray:
        return self._numbers(section, "codebook", CODES, _MAX_CODE).astype(np.float32)

    def _pixels(self, section: str, file: int = 0) -> np.ndarray:
        """The pixels of the Gaussians in a picture, uint8 (N, 4)."""
        return self._picture(section, file, pixels=self._count)[: self._count]

    def _file_name(self, section: str, file: int) -> str:
        names = self._field(section, "files")
        if not isinstance(names, list) or len(names) <= file or not isinstance(names[file], str):
            raise DatasetError(f"{self._path}: {SOG_META_NAME}: {section}.files names no file {file}")
        return names[file]

    def _width(self, section: str, file: int) -> int:
        """Width of a picture, whose pixels are not decoded, at most those of the largest palette."""
        most = _MAX_PALETTE * (num_functions(MAX_DEGREE) - 1)
        name = self._file_name(section, file)
        try:
            data = io.BytesIO(self._bytes(name, _PICTURE_BYTES * _most_pixels(most) + _SPARE_BYTES))
            with warnings.catch_warnings(), Image.open(data, formats=["WEBP"]) as image:
                return image.width
        except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError) as error:
            raise DatasetError(f"{self._path}: {name[:80]} is no WebP picture: {error}") from error

    def _picture(self, section: str, file: int, *, pixels: int, width: int | None = None) -> np.ndarray:
        name = self._file_name(section, file)
        try:
            data = io.BytesIO(self._bytes(name, _PICTURE_BYTES * _most_pixels(pixels) + _SPARE_BYTES))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of large pictures: the size is checked before pixels are decoded
                image = Image.open(data, formats=["WEBP"])
            with image:
                has = image.width * image.height
                if not pixels <= has <= _most_pixels(pixels) or width not in (None, image.width):
                    size = f"{image.width} x {image.height}"
                    raise DatasetError(f"{self._path}: {name[:80]} is {size} pixels, {pixels} are needed")
                return np.asarray(image.convert("RGBA")).reshape(-1, 4)
        except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError) as error:
            raise DatasetError(f"{self._path}: {name[:80]} is no WebP picture: {error}") from error


def _most_pixels(pixels: int) -> int:
    """How many pixels a picture of so many may have: sides are rounded up as its writer likes."""
    return 2 * pixels + _SPARE_PIXELS
