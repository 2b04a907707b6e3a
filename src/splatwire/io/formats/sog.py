"""SOG (github.com/playcanvas/splat-transform): a `meta.json` and lossless WebP images, as folder or zip; RDF axes.

`meta.json` has the paths of the images relative to its own folder. Pixel i of an image belongs to Gaussian i, except in
the image of the palette:

* Positions: sign(x) log(1 + |x|), quantised to 16 bits between a minimum and a maximum.
* Rotations: the three smallest of w, x, y and z, 8 bits each, and the index of the largest.
* Scales, and harmonics of degree 0: indices into code books of 256 numbers.
* Other harmonics: index into a palette of vectors. The palette has, for each component of a vector, an index into
  another code book.

Version 1 has a minimum and a maximum of each channel instead of code books. The fourth channel of the image `sh0` is
the opacity; in version 1 it is the logit of the opacity.
"""

import contextlib
import io
import json
import logging
import warnings
from collections.abc import Collection, Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from splatwire.errors import DatasetError
from splatwire.files.archive import Archive, open_archive
from splatwire.files.kinds import SOG_LEVELS_NAME, SOG_META_NAME
from splatwire.files.read_limited import read_limited
from splatwire.io.formats._asset import metadata_of_asset, origin_of_asset, warn_of_unused_extras
from splatwire.io.formats._columns import build_splats, check_count
from splatwire.io.formats._files import is_in_folder_of, warn_of_bytes_outside
from splatwire.io.formats._placement import warn_of_unused_fields
from splatwire.io.formats._rotations import from_smallest_three
from splatwire.io.formats.content import FileContent
from splatwire.io.formats.ply_comments import fields_as_comments, states_antialiasing, warn_of_unclear_antialiasing
from splatwire.ops.spherical_harmonics import MAX_DEGREE, num_functions
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
PALETTE_COLUMNS = 64
CODES = 256
_SECTIONS = ("means", "scales", "quats", "sh0", "shN")
_FIELDS = frozenset(("files", "mins", "maxs", "codebook", "count", "bands", "palette_size", "coeffs"))
_MAX_META_BYTES = 1 << 20
_MAX_PALETTE = 1 << 16
_SPARE_PIXELS = 1 << 16
_PICTURE_BYTES, _SPARE_BYTES = 5, 1 << 16
"""Limit of an image file: bytes per pixel, and additional bytes, because incompressible data grows slightly."""
_WEBP_HEADER, _LOSSY = 12, b"VP8 "
"""Size of the header of a WebP before its chunks, bytes, and the tag of the chunk with a lossy image."""
_WITH_ALPHA, _MIN_OPAQUE = ("quats",), 8
"""Sections whose image needs an alpha channel, and smallest number of Gaussians for a warning if it is missing."""
_FIRST_CODE = 252
"""Alpha value of rotations whose first component is the largest; the next values, up to 255, are for the others."""
_ROWS = 1 << 16
_MAX_LOG_POSITION = 40.0
_MAX_CODE = 1e6
_CHANNEL = np.float32(255)
"""Maximum value of an image channel."""


def read_sog(path: Path) -> FileContent:
    """Reads a SOG: a bundled `.sog` file, a folder with a `meta.json`, or the path of that `meta.json`.

    Raises:
        DatasetError: If something is missing, damaged, or of wrong version or size.
        OSError: If a file cannot be read.
    """
    with _opened(path) as sog:
        warn_of_bytes_outside(path, sog.bytes_outside, "before or after its zip")
        warn_of_unused_fields(path, {name: sog.meta[name] for name in sog.meta if name != "asset"})
        warn_of_unused_extras(path, sog.meta.get("asset"))
        sog.warn_of_unknown_fields()
        return FileContent(
            sog.splats(),
            origin_of_asset(sog.meta.get("asset"), path),
            antialiased=sog.is_antialiased(),
            metadata=metadata_of_asset(sog.meta.get("asset"), path),
        )


def is_antialiased(path: Path) -> bool:
    """True if a valid SOG declares that its scene was trained with antialiasing."""
    with _opened(path) as sog:
        return sog.is_antialiased()


def read_asset(path: Path) -> object:
    """Returns the metadata object `asset` of a valid SOG; None if the SOG has no such object."""
    with _opened(path) as sog:
        return sog.meta.get("asset")


@contextlib.contextmanager
def _opened(path: Path) -> "Iterator[_Sog]":
    if path.is_dir() or path.name == SOG_META_NAME:
        yield _Sog(path, _FolderFiles(path / SOG_META_NAME if path.is_dir() else path))
        return
    with open_archive(path, DatasetError) as bundle:
        sog = _Sog(path, _ArchiveFiles(path, bundle))
        sog.bytes_outside = bundle.bytes_outside()
        yield sog


def stored_bytes(path: Path) -> int:
    """Returns the number of bytes that a valid SOG takes on disk."""
    with _opened(path) as sog:
        return sog.stored_bytes()


class _FolderFiles:
    """Reader of the files of a SOG that is a folder on disk.

    A file is named by its path relative to the folder of `meta.json`.
    """

    def __init__(self, meta: Path) -> None:
        self._meta = meta

    def size(self, name: str) -> int | None:
        """Returns the size of a file in bytes; None if there is no such file.

        Raises:
            DatasetError: If the file is a symbolic link to a place outside of the folder.
        """
        file = self._meta.parent / name
        if not file.is_file():
            return None
        if not is_in_folder_of(self._meta, file):
            raise DatasetError(f"{self._meta}: {name[:80]!r} is a link out of its folder: replace it by a copy")
        return file.stat().st_size

    def stored_bytes(self, names: set[str]) -> int:
        """Returns the number of bytes that the named files take on disk."""
        return sum(self.size(name) or 0 for name in names)

    def read(self, name: str, limit: int) -> bytes:
        """Reads an existing file of at most `limit` bytes."""
        return read_limited(self._meta.parent / name, limit, DatasetError)


class _ArchiveFiles:
    """Reader of the files of a SOG that is a zip archive.

    A file is named by its path relative to the folder of `meta.json` in the archive.

    Raises:
        DatasetError: If the archive has no `meta.json`, or several; or if two members have the same path, such as
            `a.webp` and `./a.webp`.
    """

    def __init__(self, path: Path, bundle: Archive) -> None:
        self._path, self._bundle = path, bundle
        members: dict[str, str] = {}
        for member in bundle.sizes:
            name = _plain_name(member)
            if not member.endswith("/") and members.setdefault(name, member) != member:
                raise DatasetError(f"{path}: the zip has two members {name[:80]!r}")
        folder = _folder_of(path, members)
        self._members = {name[len(folder) :]: member for name, member in members.items() if name.startswith(folder)}

    def size(self, name: str) -> int | None:
        """Returns the decompressed size of a file in bytes; None if there is no such file."""
        member = self._members.get(name)
        return None if member is None else self._bundle.sizes[member]

    def stored_bytes(self, names: set[str]) -> int:
        """Returns the size of the whole archive on disk in bytes; `names` is ignored."""
        return self._path.stat().st_size

    def read(self, name: str, limit: int) -> bytes:
        """Decompresses an existing file of at most `limit` bytes."""
        return self._bundle.read(self._members[name], limit)


def _plain_name(name: str) -> str:
    """Returns a relative path with slashes and without `.` parts; some programs write backslashes or a leading `./`."""
    return str(PurePosixPath(name.replace("\\", "/")))


def _folder_of(path: Path, names: Collection[str]) -> str:
    """Returns the folder of `meta.json` in an archive, with trailing slash; empty for the top level.

    Args:
        path: The archive, for messages.
        names: Names of the files in the archive.

    Raises:
        DatasetError: If there is no such folder, or several.
    """
    paths = [PurePosixPath(name) for name in names]
    if SOG_META_NAME in names:
        return ""
    if any(name.name == SOG_LEVELS_NAME for name in paths):
        raise DatasetError(f"{path}: an archive of a streamed SOG ({SOG_LEVELS_NAME}): unpack it and name its folder")
    folders = [name.parent for name in paths if name.name == SOG_META_NAME and name.parts[0] != "__MACOSX"]
    if len(folders) > 1:
        raise DatasetError(
            f"{path}: {len(folders)} folders in it have a {SOG_META_NAME}: unpack it and name one of them"
        )
    if not folders:
        content = next((f", its first file is {name[:80]!r}" for name in names), "")
        raise DatasetError(f"{path}: {SOG_META_NAME} is missing, so this zip is no SOG{content}: unpack it")
    return f"{folders[0]}/"


class _Sog:
    """Reader of one SOG, from a zip archive or a folder.

    Attributes:
        meta: Content of its `meta.json`.
        bytes_outside: Number of bytes before and after the zip archive in the file; 0 for a folder.
    """

    bytes_outside = 0

    def __init__(self, path: Path, files: _FolderFiles | _ArchiveFiles) -> None:
        self._path, self._files = path, files
        self.meta = self._read_meta()
        version = self.meta.get("version", 1)
        if version not in (1, 2) or type(version) is not int:
            raise DatasetError(f"{path}: SOG of version {version!r:.20}; versions 1 and 2 are read")
        self._is_version_1 = version == 1
        self._widths: dict[str, int] = {}
        count = self._version1_count() if self._is_version_1 else self.meta.get("count")
        if type(count) is not int:  # bool is a subclass of int
            raise DatasetError(f"{path}: {SOG_META_NAME}: count is {count!r:.40}, not a number of Gaussians")
        self._count = check_count(path, count, self.stored_bytes())

    def stored_bytes(self) -> int:
        """Returns the number of bytes that `meta.json` and its images take on disk."""
        return self._files.stored_bytes({SOG_META_NAME, *self._named_files()})

    def is_antialiased(self) -> bool:
        """Returns the flag `antialias` of `meta.json`. An invalid value is logged and counts as False.

        Without this flag, fields of other programs count, such as `antialiased` or `SplatRenderMode`.
        """
        stated = self.meta.get("antialias")
        if stated is None:
            fields = self._other_fields()
            warn_of_unclear_antialiasing(self._path, fields, "field")
            return states_antialiasing(fields)
        if stated not in (False, True):
            LOG.warning(
                "%s: antialias %.40r is not a boolean: the scene is drawn without antialiasing", self._path, stated
            )
        return stated in (True,)

    def _other_fields(self) -> list[str]:
        """Returns the fields of `meta.json`, its `asset` and the `extras` of that, in the form of comments."""
        asset = self.meta.get("asset")
        extras = asset.get("extras") if isinstance(asset, dict) else None
        return [comment for fields in (self.meta, asset, extras) for comment in fields_as_comments(fields)]

    def warn_of_unknown_fields(self) -> None:
        """Logs a warning about unknown fields of sections, and about unknown sections that have images."""
        sections = {name: part for name, part in self.meta.items() if isinstance(part, dict) and "files" in part}
        unknown = [name for name in sections if name not in _SECTIONS]
        if not self._is_version_1:
            unknown += [f"{name}.{field}" for name, part in sections.items() for field in part.keys() - _FIELDS]
        if unknown:
            LOG.warning(
                "%s: %s of %s are not known: the scene may look different",
                self._path, ", ".join(sorted(unknown))[:120], SOG_META_NAME,
            )  # fmt: skip

    def _version1_count(self) -> Any:
        """Returns the number of Gaussians in a version 1 file, from the array shapes in `meta.json`."""
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
        size = self._files.size(name)
        if size is None:
            raise DatasetError(f"{self._path}: {name[:80]} is missing")
        if size > limit:
            raise DatasetError(f"{self._path}: {name[:80]} has {size} bytes, the limit is {limit}")
        return self._files.read(name, limit)

    def _named_files(self) -> list[str]:
        """Returns the relative path of each image file that `meta.json` names.

        Raises:
            DatasetError: If a path is absolute or leads out of the folder of `meta.json`.
        """
        sections = [section for section in self.meta.values() if isinstance(section, dict)]
        lists = [names for section in sections if isinstance(names := section.get("files"), list)]
        return [self._image_name(name) for names in lists for name in names if isinstance(name, str)]

    def _image_name(self, stated: str) -> str:
        """Returns the relative path of an image file that `meta.json` names.

        Raises:
            DatasetError: If the path is absolute or leads out of the folder of `meta.json`.
        """
        path = PurePosixPath(_plain_name(stated))
        if not path.parts or path.is_absolute() or ".." in path.parts or ":" in path.parts[0] or "\0" in stated:
            raise DatasetError(
                f"{self._path}: {SOG_META_NAME} names {stated[:80]!r}, which is no file in its folder or below"
            )
        return str(path)

    def _check_names(self) -> None:
        """Checks that no image file is referenced twice.

        Raises:
            DatasetError: If a file is named twice.
        """
        named = self._named_files()
        if twice := next((name for name in named if named.count(name) > 1), None):
            raise DatasetError(f"{self._path}: {SOG_META_NAME} names {twice[:80]} twice: a picture has one meaning")

    def splats(self) -> Splats:
        self._check_names()
        low, high = (self._pixels("means", file) for file in range(2))
        bounds = [self._numbers("means", side, 3, _MAX_LOG_POSITION).astype(np.float32) for side in ("mins", "maxs")]
        if (bounds[0] > bounds[1]).any():
            raise DatasetError(f"{self._path}: {SOG_META_NAME}: a number of means.mins is above that of means.maxs")
        share = (low[:, :3] + np.float32(256) * high[:, :3]) / np.float32(65535)
        logs = bounds[0] + (bounds[1] - bounds[0]) * share
        colors, opacities = self._version1_colors() if self._is_version_1 else self._colors()
        quats, log_scales, sh = self._rotations(), self._log_scales(), self._harmonics(colors)
        self._warn_of_different_widths()
        return build_splats(
            self._path,
            means=np.sign(logs) * np.expm1(np.abs(logs)),
            quats=quats,
            log_scales=log_scales,
            opacities=opacities,
            sh=sh,
        )

    def _warn_of_different_widths(self) -> None:
        """Logs a warning if the images with one pixel for each Gaussian have different widths."""
        if len(set(self._widths.values())) > 1:
            LOG.warning(
                "%s: its images have different widths (%s pixels), so programs may assign their pixels to other "
                "Gaussians: pixels are counted row by row in each image",
                self._path, ", ".join(f"{name[:60]}: {width}" for name, width in self._widths.items()),
            )  # fmt: skip

    def _log_scales(self) -> np.ndarray:
        pixels = self._pixels("scales")[:, :3]
        return self._from_bounds("scales", pixels) if self._is_version_1 else self._codebook("scales")[pixels]

    def _colors(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the spherical harmonics coefficients of degree 0, (N, 3), and the opacities, (N)."""
        pixels = self._pixels("sh0")
        return self._codebook("sh0")[pixels[:, :3]], pixels[:, 3] / _CHANNEL

    def _version1_colors(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns spherical harmonics coefficients of degree 0, (N, 3), and opacities, (N), of a version 1 file."""
        values = self._from_bounds("sh0", self._pixels("sh0"))
        return values[:, :3], 1 / (1 + np.exp(-values[:, 3]))

    def _from_bounds(self, section: str, pixels: np.ndarray) -> np.ndarray:
        """Decodes the quantised values of a section of a version 1 file, float32 (N, C).

        Maps 0 to 255 linearly to the range from the minimum to the maximum in the section's metadata.

        Args:
            section: Name of the section.
            pixels: Quantised values, uint8 (N, C).
        """
        low, high = (self._numbers(section, side, pixels.shape[1], _MAX_CODE) for side in ("mins", "maxs"))
        return (low + (high - low) * (pixels / _CHANNEL)).astype(np.float32)

    def _rotations(self) -> np.ndarray:
        """Returns the rotations as quaternions (N, 4)."""
        picture = self._picture("quats", 0, pixels=self._count)
        pixels, padding = picture[: self._count], picture[self._count :]
        # Colours of transparent pixels are arbitrary: WebP changes them unless an option keeps them. White is no
        # rotation, and some programs fill images with it.
        is_value = padding[:, :3].any(axis=1) & ~(padding == CODES - 1).all(axis=1)
        if num_more := int((is_value & (padding[:, 3] >= _FIRST_CODE)).sum()):
            LOG.warning(
                "%s: its images have values of %s more Gaussians than the %s of %s: those are left out",
                self._path, f"{num_more:,}", f"{self._count:,}", SOG_META_NAME,
            )  # fmt: skip
        return from_smallest_three(pixels[:, 3].astype(np.int64) - _FIRST_CODE, pixels[:, :3] / _CHANNEL)

    def _harmonics(self, constant: np.ndarray) -> np.ndarray:
        """Returns all spherical harmonics coefficients (N, D, 3).

        Args:
            constant: Coefficients of degree 0, (N, 3).
        """
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
        harmonics = np.empty((self._count, 1 + width, 3), np.float32)
        harmonics[:, 0] = constant
        for start in range(0, self._count, _ROWS):  # in batches: entries are four times as large as codes
            harmonics[start : start + _ROWS, 1:] = codebook[codes[np.minimum(label[start : start + _ROWS], count - 1)]]
        harmonics[label >= count] = np.nan
        return harmonics

    def _palette_size(self) -> tuple[Any, Any]:
        """Returns the degree of the spherical harmonics, and the number of entries of their palette."""
        if not self._is_version_1:
            section = self.meta["shN"]  # LichtFeld Studio names the number `palette_size`
            is_renamed = isinstance(section, dict) and "palette_size" in section and "count" not in section
            return self._field("shN", "bands"), self._field("shN", "palette_size" if is_renamed else "count")
        labels = self._pixels("shN", 1).astype(np.int64)
        width = self._palette_width("shN", 0)
        bands = next((n for n in range(1, MAX_DEGREE + 1) if PALETTE_COLUMNS * (num_functions(n) - 1) == width), width)
        return bands, int((labels[:, 0] + 256 * labels[:, 1]).max()) + 1

    def _palette_codebook(self) -> np.ndarray:
        """Returns the decoded value of each pixel value of the palette image, float32 (256)."""
        if not self._is_version_1:
            return self._codebook("shN")
        low, high = (self._numbers("shN", side, None, _MAX_CODE) for side in ("mins", "maxs"))
        return (low + (high - low) * np.linspace(0, 1, CODES)).astype(np.float32)

    def _field(self, section: str, name: str) -> Any:
        content = self.meta.get(section)
        if not isinstance(content, dict) or name not in content:
            raise DatasetError(f"{self._path}: {SOG_META_NAME}: {section}.{name} is missing")
        return content[name]

    def _numbers(self, section: str, name: str, count: int | None, limit: float) -> np.ndarray:
        """Returns numbers of a section of `meta.json`.

        Args:
            section: Name of the section.
            name: Name of the field in the section.
            count: Required length of the list; None for a single number instead of a list.
            limit: Maximum absolute value.

        Returns:
            float64 (count), or float64 () for a single number.

        Raises:
            DatasetError: If the field has another number of values, or one exceeds the limit.
        """
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
        """Returns the value of each index, float32 (256). Indices for which the file has no value get NaN."""
        stated = self._field(section, "codebook")
        count = len(stated) if isinstance(stated, list) and 0 < len(stated) < CODES else CODES
        codebook = np.full(CODES, np.nan, np.float32)
        codebook[:count] = self._numbers(section, "codebook", count, _MAX_CODE)
        return codebook

    def _pixels(self, section: str, file: int = 0) -> np.ndarray:
        """Returns the pixel of each Gaussian in an image of a section, RGBA, uint8 (N, 4).

        Args:
            section: Name of the section, such as `means`.
            file: Index of the image in the section's list of files.
        """
        return self._picture(section, file, pixels=self._count)[: self._count]

    def _warn_if_lossy(self, name: str, data: memoryview) -> None:
        """Logs a warning if a WebP image is lossy, because lossy compression makes the stored values wrong."""
        offset = _WEBP_HEADER
        while offset + 8 <= len(data) and bytes(data[offset : offset + 4]) != _LOSSY:
            offset += 8 + -(-int.from_bytes(data[offset + 4 : offset + 8], "little") // 2) * 2
        if offset + 8 <= len(data):
            LOG.warning(
                "%s: %.80s is a lossy WebP, and SOG needs lossless ones: its values are not those of the scene; "
                "images may have been optimised after the export", self._path, name,
            )  # fmt: skip

    def _file_name(self, section: str, file: int) -> str:
        names = self._field(section, "files")
        if not isinstance(names, list) or len(names) <= file or not isinstance(names[file], str):
            raise DatasetError(f"{self._path}: {SOG_META_NAME}: {section}.files names no file {file}")
        return self._image_name(names[file])

    def _palette_width(self, section: str, file: int) -> int:
        """Returns the width of an image in pixels from its header, without decoding the pixels.

        Args:
            section: Name of the section that the image belongs to.
            file: Index of the image in the section's list of files.

        Raises:
            DatasetError: If it is not a WebP image, or its file exceeds the size limit for the image of a palette.
        """
        num_pixels = _MAX_PALETTE * (num_functions(MAX_DEGREE) - 1)
        name = self._file_name(section, file)
        try:
            data = io.BytesIO(self._bytes(name, _PICTURE_BYTES * _max_pixels(num_pixels) + _SPARE_BYTES))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                image = Image.open(data, formats=["WEBP"])
            with image:
                return image.width
        except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError) as error:
            raise DatasetError(f"{self._path}: {name[:80]} is no WebP picture{_reason(error)}") from error

    def _picture(self, section: str, file: int, *, pixels: int, width: int | None = None) -> np.ndarray:
        name = self._file_name(section, file)
        try:
            data = io.BytesIO(self._bytes(name, _PICTURE_BYTES * _max_pixels(pixels) + _SPARE_BYTES))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the size is checked below, before pixels are decoded
                image = Image.open(data, formats=["WEBP"])
            with image:
                num_pixels = image.width * image.height
                if not pixels <= num_pixels <= _max_pixels(pixels) or width not in (None, image.width):
                    size = f"{image.width} x {image.height}"
                    raise DatasetError(f"{self._path}: {name[:80]} is {size} pixels, {pixels} are needed")
                if width is None:
                    self._widths[name] = image.width
                if getattr(image, "n_frames", 1) > 1:
                    raise DatasetError(f"{self._path}: {name[:80]} is an animation; images of SOG are stills")
                self._warn_if_lossy(name, data.getbuffer())
                if section in _WITH_ALPHA and "A" not in image.getbands() and self._count >= _MIN_OPAQUE:
                    LOG.warning(
                        "%s: %.80s has no alpha channel, which has values of the Gaussians: it may have been lost when "
                        "images were converted after the export", self._path, name,
                    )  # fmt: skip
                return np.asarray(image.convert("RGBA")).reshape(-1, 4)
        except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError) as error:
            raise DatasetError(f"{self._path}: {name[:80]} is no WebP picture{_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Formats an exception of the image library as the end of an error message."""
    return "" if isinstance(error, UnidentifiedImageError) else f": {error}"


def _max_pixels(pixels: int) -> int:
    """Returns the maximum accepted number of pixels of an image with padding.

    Args:
        pixels: Number of pixels that the Gaussians need.
    """
    return 2 * pixels + _SPARE_PIXELS
