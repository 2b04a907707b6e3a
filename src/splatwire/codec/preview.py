"""Preview: about a hundred explicit Gaussians in one datagram, shown until the scene itself has arrived.

It is an optional named section of the side information (docs/format.md, section `preview`).
"""
# A preview is the only part of a scene in the transport's welcome message. It is not entropy-coded and independent of
# all other data, so any release can read it.

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.ops.spherical_harmonics import DC
from splatwire.types import Gaussians, SplatScene
from splatwire.types.background import Background
from splatwire.types.splats import Splats

SECTION = "preview"
"""Name of the section."""
MAX_PREVIEW_BYTES = 1024
"""Maximum size, bytes. A welcome message with a preview and ten parity ranges then fits 1200 bytes."""
VERSION = 1
BITS = (8, 8, 8, 5, 5, 5, 5, 5, 5, 4)
"""Bits of a Gaussian's numbers: position x, y, z; size x, y, z; red, green, blue; opacity."""
MAX_DISTANCE_ASINH = 8.0
"""Largest asinh of a distance from the centre, in spreads; corresponds to 1490 spreads."""
SIZES = (-12.0, 6.0)
"""Smallest and largest `log(size / spread)`, a natural logarithm."""
SPREADS = (2.0**-20, 2.0**20)
"""Smallest and largest spread, world units."""
FARTHEST = 2.0**20
"""Largest absolute coordinate of the centre, world units."""
MAX_LEVELS = tuple((1 << bits) - 1 for bits in BITS)
_GAUSSIAN_BITS = sum(BITS)
_HEADER_BYTES = 53
MAX_GAUSSIANS = (MAX_PREVIEW_BYTES - _HEADER_BYTES) * 8 // _GAUSSIAN_BITS


@dataclass(frozen=True)
class PreviewQuantisation:
    """Quantisation parameters of a preview: ranges of positions and sizes.

    A coordinate x is quantised as `asinh((x - middle) / spread)`, which is precise near the centre and coarse far away.

    Attributes:
        middle: Centre of the scene, world units.
        spread: Distance up to which positions have nearly uniform precision, world units.
        low: Minima of four values before quantisation: the three transformed coordinates, and `log(size / spread)`, a
            natural logarithm.
        high: Maxima of these four values.
    """

    middle: tuple[float, float, float]
    spread: float
    low: tuple[float, float, float, float]
    high: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        if wrong := self._problem():
            raise InvalidValueError(wrong)

    def _problem(self) -> str | None:
        """Returns a message about the first invalid field, or None if all fields are valid."""
        if not all(abs(value) <= FARTHEST for value in self.middle):
            return "its middle is out of range"
        if not SPREADS[0] <= self.spread <= SPREADS[1]:
            return "its spread is out of range"
        bounds = [(-MAX_DISTANCE_ASINH, MAX_DISTANCE_ASINH)] * 3 + [SIZES]
        names = ("x", "y", "z", "sizes")
        for name, low, high, (least, most) in zip(names, self.low, self.high, bounds, strict=True):
            if not least <= low <= high <= most:
                return f"its range of {name} is impossible"
        return None

    @staticmethod
    def fitting(
        middle: Sequence[float], linear_range: float, low: Sequence[float], high: Sequence[float]
    ) -> "PreviewQuantisation":
        """Creates the quantisation parameters of a preview from the ranges of the values to quantise.

        Ranges beyond the limits of the format are clipped.

        Args:
            middle: Centre of the scene, world units.
            linear_range: Distance up to which positions have nearly uniform precision, world units.
            low: Minima of four values: the three coordinates, transformed by `asinh((x - middle) / linear_range)`,
                and `log(size / linear_range)`, a natural logarithm.
            high: Maxima of these four values.

        Raises:
            InvalidValueError: If `middle` or `linear_range` is out of range.
        """
        (x, y, z), bounds = _sent(middle), [(-MAX_DISTANCE_ASINH, MAX_DISTANCE_ASINH)] * 3 + [SIZES]
        least, most = (
            [min(max(value, a), b) for value, (a, b) in zip(_sent(values), bounds, strict=True)]
            for values in (low, high)
        )
        return PreviewQuantisation(
            (x, y, z),
            _sent([linear_range])[0],
            (least[0], least[1], least[2], least[3]),
            (most[0], most[1], most[2], most[3]),
        )

    def values(self, codes: Float[np.ndarray, "G 10"]) -> Float[np.ndarray, "G 10"]:
        """Dequantises the ten numbers that describe each of the G Gaussians of a preview.

        Args:
            codes: Quantised numbers of each Gaussian, integers as in `Preview.levels`.

        Returns:
            Ten numbers for each Gaussian: position, compressed by asinh (3); `log(size / spread)` of
            each axis (3); colour (3); opacity (1).
        """
        low, step = self.scale()
        return low + codes * step

    def levels(self, values: Float[np.ndarray, "G 10"]) -> Float[np.ndarray, "G 10"]:
        """Quantises the ten numbers that describe each of G Gaussians, but does not round the results to integers.

        This is the inverse of the method `values`. Results are clipped to the range of the coded integers.

        Args:
            values: Ten numbers for each Gaussian, as returned by `values`.
        """
        low, step = self.scale()
        return np.clip((values - low) / np.maximum(step, 1e-12), 0, np.array(MAX_LEVELS))

    def gaussians(self, values: Float[np.ndarray, "G 10"]) -> Gaussians:
        """Converts the ten numbers that describe each of G Gaussians, as returned by `values`, to Gaussians."""
        positions = (np.array(self.middle) + self.spread * np.sinh(values[:, :3])).astype(np.float32)
        upright = np.tile(np.array([1.0, 0.0, 0.0, 0.0], values.dtype), (len(values), 1))
        return Gaussians(positions, upright, self.spread * np.exp(values[:, 3:6]), values[:, 9], values[:, 6:9])

    def scale(self) -> tuple[Float[np.ndarray, "10"], Float[np.ndarray, "10"]]:
        """Returns the offset and the quantisation step of each of the ten numbers that describe a Gaussian.

        The numbers are: position, compressed by asinh (3); `log(size / spread)` of each axis (3); red, green, blue
        (3); opacity (1). A quantised integer q represents the number `offset + q * step`.

        Returns:
            Offsets, and quantisation steps.
        """
        half = 0.5 / (1 << BITS[9])
        low = [*self.low[:3], *self.low[3:] * 3, 0.0, 0.0, 0.0, half]
        high = [*self.high[:3], *self.high[3:] * 3, 1.0, 1.0, 1.0, 1 - half]
        steps = [(most - least) / count for least, most, count in zip(low, high, MAX_LEVELS, strict=True)]
        return np.array(low), np.array(steps)


@dataclass(frozen=True, eq=False)
class Preview:
    """A quantised preview: about a hundred Gaussians that are shown before the scene.

    Attributes:
        frame: Quantisation parameters, with which the integers are dequantised.
        background: RGB background colour, 0 to 255 each.
        levels: Quantised parameters: ten integers per Gaussian, of `BITS` bits, int64 (G, 10).
    """

    frame: PreviewQuantisation
    background: tuple[int, int, int]
    levels: np.ndarray

    def __post_init__(self) -> None:
        count = len(self.levels)
        if not 1 <= count <= MAX_GAUSSIANS or self.levels.shape != (count, len(BITS)):
            raise InvalidValueError(f"a preview has 1 to {MAX_GAUSSIANS} Gaussians, not {self.levels.shape}")
        if (self.levels < 0).any() or (self.levels > np.array(MAX_LEVELS)).any():
            raise InvalidValueError("a number of a preview does not fit its bits")

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians, G."""
        return len(self.levels)

    def gaussians(self) -> Gaussians:
        """Returns the Gaussians to render."""
        values = self.frame.gaussians(self.frame.values(self.levels.astype(np.float64)))
        return Gaussians(**{name: column.astype(np.float32) for name, column in vars(values).items()})


def preview_scene(data: bytes) -> SplatScene:
    """Converts a serialised preview to a scene, for renderers and file writers.

    Raises:
        BitstreamError: If the bytes are not a preview.
    """
    shown, background = preview_gaussians(data)
    splats = Splats(shown.means, shown.quats, shown.scales, shown.opacities, (shown.colors[:, None, :] - 0.5) / DC)
    return SplatScene(splats, background=background)


def _sent(values: Sequence[float]) -> list[float]:
    return [float(value) for value in np.asarray(values, dtype=np.float32)]


def gaussians_within(num_bytes: int) -> int:
    """Returns the maximum number of Gaussians in a preview of `num_bytes` bytes; 0 if not even one fits."""
    return max(0, (min(num_bytes, MAX_PREVIEW_BYTES) - _HEADER_BYTES) * 8 // _GAUSSIAN_BITS)


def write_preview(preview: Preview) -> bytes:
    """Serialises a preview, in at most `MAX_PREVIEW_BYTES`."""
    writer, frame = ByteWriter(), preview.frame
    for byte in (VERSION, preview.num_gaussians, *preview.background):
        writer.u8(byte)
    for number in (*frame.middle, frame.spread, *frame.low, *frame.high):
        writer.f32(number)
    columns = [(preview.levels[:, n : n + 1] >> np.arange(bits)[::-1]) & 1 for n, bits in enumerate(BITS)]
    return writer.bytes() + np.packbits(np.concatenate(columns, axis=1).astype(np.uint8)).tobytes()


def read_preview(data: bytes) -> Preview:
    """Parses a preview written by `write_preview`; checks all fields.

    Raises:
        UnsupportedVersionError: If a newer release wrote the preview.
        BitstreamError: If the bytes are not a preview.
    """
    if len(data) > MAX_PREVIEW_BYTES:
        raise BitstreamError(f"preview: {len(data):,} bytes, at most {MAX_PREVIEW_BYTES} are possible")
    reader = ByteReader(data, "preview")
    version = reader.u8()
    if version != VERSION:
        raise UnsupportedVersionError(f"preview: version {version}, this release reads {VERSION}")
    count, *background = (reader.u8() for _ in range(4))
    numbers = [reader.f32() for _ in range(12)]
    body = np.unpackbits(np.frombuffer(reader.take(-(-count * _GAUSSIAN_BITS // 8)), dtype=np.uint8))
    reader.finish()
    if body[count * _GAUSSIAN_BITS :].any():
        raise BitstreamError("preview: bits behind the last Gaussian are not 0")
    bits = body[: count * _GAUSSIAN_BITS].reshape(count, _GAUSSIAN_BITS).astype(np.int64)
    parts = np.split(bits, np.cumsum(BITS)[:-1], axis=1)
    levels = np.stack([part @ (1 << np.arange(part.shape[1])[::-1]) for part in parts], axis=1)
    (x, y, z), spread, low, high = numbers[:3], numbers[3], numbers[4:8], numbers[8:]
    try:
        frame = PreviewQuantisation(
            (x, y, z), spread, (low[0], low[1], low[2], low[3]), (high[0], high[1], high[2], high[3])
        )
        return Preview(frame, (background[0], background[1], background[2]), levels)
    except InvalidValueError as error:
        raise BitstreamError(f"preview: {error}") from None


def preview_gaussians(data: bytes) -> tuple[Gaussians, Background]:
    """Returns the Gaussians and the background of a serialised preview.

    Args:
        data: The preview in encoded form: bytes of the section `preview`, or the preview in a server's welcome message.

    Returns:
        Gaussians, and the RGB background colour.

    Raises:
        BitstreamError: If the bytes are not a preview.
    """
    preview = read_preview(data)
    red, green, blue = (value / 255 for value in preview.background)
    return preview.gaussians(), (red, green, blue)
