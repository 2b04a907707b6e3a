"""A preview: a hundred explicit Gaussians in one datagram, to look at until the scene itself is there.

It is a named section of the side information that some streams have, and all that the transport's welcome carries of a
scene (docs/format.md, section `preview`). Nothing is decoded under probabilities: any release can read it, whatever
became of the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.model import SplatScene
from splatwire.ops.spherical_harmonics import DC
from splatwire.scene import Gaussians
from splatwire.scene.background import Background
from splatwire.scene.splats import Splats

SECTION = "preview"
"""Name of the section."""
MAX_PREVIEW_BYTES = 1024
"""A welcome with this and ten runs of packets is still no larger than 1200 bytes."""
VERSION = 1
BITS = (8, 8, 8, 5, 5, 5, 5, 5, 5, 4)
"""Of a Gaussian's numbers: place along x, y, z; size along x, y, z; red, green, blue; opacity."""
MOST_AWAY = 8.0
"""Largest asinh of a distance from the middle, in spreads: 1490 of them."""
SIZES = (-12.0, 6.0)
"""Least and largest natural logarithm of a size, in spreads."""
SPREADS = (2.0**-20, 2.0**20)
"""Least and largest spread, world units."""
FARTHEST = 2.0**20
"""Largest coordinate of the middle, world units."""
MOST_LEVELS = tuple((1 << bits) - 1 for bits in BITS)
_GAUSSIAN_BITS = sum(BITS)
_HEADER_BYTES = 53
MAX_GAUSSIANS = (MAX_PREVIEW_BYTES - _HEADER_BYTES) * 8 // _GAUSSIAN_BITS


@dataclass(frozen=True)
class PreviewFrame:
    """Where the Gaussians of a preview are, and how far the steps of their numbers reach.

    Places are sent as asinh of the distance from the middle in spreads: fine near the middle, coarse far away.

    Attributes:
        middle: What the scene is around, world units.
        spread: Distance up to which places are about evenly fine, world units.
        low: Least asinh along x, y and z, and least logarithm of a size in spreads.
        high: The largest ones.
    """

    middle: tuple[float, float, float]
    spread: float
    low: tuple[float, float, float, float]
    high: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        if wrong := self._problem():
            raise InvalidValueError(wrong)

    def _problem(self) -> str | None:
        """What cannot be, in words; comparisons are written so that NaN fails them."""
        if not all(abs(value) <= FARTHEST for value in self.middle):
            return "its middle is out of range"
        if not SPREADS[0] <= self.spread <= SPREADS[1]:
            return "its spread is out of range"
        bounds = [(-MOST_AWAY, MOST_AWAY)] * 3 + [SIZES]
        names = ("x", "y", "z", "sizes")
        for name, low, high, (least, most) in zip(names, self.low, self.high, bounds, strict=True):
            if not least <= low <= high <= most:
                return f"its range of {name} is impossible"
        return None

    @staticmethod
    def fitting(middle: Sequence[float], spread: float, low: Sequence[float], high: Sequence[float]) -> "PreviewFrame":
        """A frame of numbers that survive the journey: float32, within what is possible.

        Raises:
            InvalidValueError: If the middle or the spread is not possible.
        """
        (x, y, z), bounds = _sent(middle), [(-MOST_AWAY, MOST_AWAY)] * 3 + [SIZES]
        least, most = (
            [min(max(value, a), b) for value, (a, b) in zip(_sent(values), bounds, strict=True)]
            for values in (low, high)
        )
        return PreviewFrame(
            (x, y, z),
            _sent([spread])[0],
            (least[0], least[1], least[2], least[3]),
            (most[0], most[1], most[2], most[3]),
        )

    def values(self, levels: Float[np.ndarray, "G 10"]) -> Float[np.ndarray, "G 10"]:
        """Turns the integers that are sent into numbers: asinh of places, logarithms of sizes, colours, opacity."""
        low, step = self.scale()
        return low + levels * step

    def levels(self, values: Float[np.ndarray, "G 10"]) -> Float[np.ndarray, "G 10"]:
        """Inverse of `values`, not rounded, within what can be sent."""
        low, step = self.scale()
        return np.clip((values - low) / np.maximum(step, 1e-12), 0, np.array(MOST_LEVELS))

    def gaussians(self, values: Float[np.ndarray, "G 10"]) -> Gaussians:
        """Turns numbers into Gaussians, whose axes are those of the world."""
        places = np.array(self.middle) + self.spread * np.sinh(values[:, :3])
        upright = np.tile(np.array([1.0, 0.0, 0.0, 0.0], values.dtype), (len(values), 1))
        return Gaussians(places, upright, self.spread * np.exp(values[:, 3:6]), values[:, 9], values[:, 6:9])

    def scale(self) -> tuple[Float[np.ndarray, "10"], Float[np.ndarray, "10"]]:
        """Number at level 0 and the step to the next."""
        half = 0.5 / (1 << BITS[9])
        low = [*self.low[:3], *self.low[3:] * 3, 0.0, 0.0, 0.0, half]
        high = [*self.high[:3], *self.high[3:] * 3, 1.0, 1.0, 1.0, 1 - half]
        steps = [(most - least) / count for least, most, count in zip(low, high, MOST_LEVELS, strict=True)]
        return np.array(low), np.array(steps)


@dataclass(frozen=True, eq=False)
class Preview:
    """A preview as it is sent.

    Attributes:
        frame: What its integers mean.
        background: RGB behind everything, 0 to 255 each.
        levels: Ten integers per Gaussian, of `BITS` bits; int64 (G, 10).
    """

    frame: PreviewFrame
    background: tuple[int, int, int]
    levels: np.ndarray

    def __post_init__(self) -> None:
        count = len(self.levels)
        if not 1 <= count <= MAX_GAUSSIANS or self.levels.shape != (count, len(BITS)):
            raise InvalidValueError(f"a preview has 1 to {MAX_GAUSSIANS} Gaussians, not {self.levels.shape}")
        if (self.levels < 0).any() or (self.levels > np.array(MOST_LEVELS)).any():
            raise InvalidValueError("a number of a preview does not fit its bits")

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians, G."""
        return len(self.levels)

    def gaussians(self) -> Gaussians:
        """What is drawn."""
        values = self.frame.gaussians(self.frame.values(self.levels.astype(np.float64)))
        return Gaussians(**{name: column.astype(np.float32) for name, column in vars(values).items()})


def preview_scene(data: bytes) -> SplatScene:
    """What a preview shows, as the scene that every renderer draws and every writer writes.

    Raises:
        BitstreamError: If the bytes are no preview.
    """
    shown, background = preview_gaussians(data)
    splats = Splats(shown.means, shown.quats, shown.scales, shown.opacities, (shown.colors[:, None, :] - 0.5) / DC)
    return SplatScene(splats, background=background)


def _sent(values: Sequence[float]) -> list[float]:
    return [float(value) for value in np.asarray(values, dtype=np.float32)]


def gaussians_within(num_bytes: int) -> int:
    """How many Gaussians a preview of some size can have; 0 if not even one."""
    return max(0, (min(num_bytes, MAX_PREVIEW_BYTES) - _HEADER_BYTES) * 8 // _GAUSSIAN_BITS)


def write_preview(preview: Preview) -> bytes:
    """Writes a preview; at most `MAX_PREVIEW_BYTES`."""
    writer, frame = ByteWriter(), preview.frame
    for byte in (VERSION, preview.num_gaussians, *preview.background):
        writer.u8(byte)
    for number in (*frame.middle, frame.spread, *frame.low, *frame.high):
        writer.f32(number)
    columns = [(preview.levels[:, n : n + 1] >> np.arange(bits)[::-1]) & 1 for n, bits in enumerate(BITS)]
    return writer.bytes() + np.packbits(np.concatenate(columns, axis=1).astype(np.uint8)).tobytes()


def read_preview(data: bytes) -> Preview:
    """Inverse of `write_preview`; believes nothing.

    Raises:
        UnsupportedVersionError: If a newer release wrote it.
        BitstreamError: If the bytes are no preview.
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
        frame = PreviewFrame((x, y, z), spread, (low[0], low[1], low[2], low[3]), (high[0], high[1], high[2], high[3]))
        return Preview(frame, (background[0], background[1], background[2]), levels)
    except InvalidValueError as error:
        raise BitstreamError(f"preview: {error}") from None


def preview_gaussians(data: bytes) -> tuple[Gaussians, Background]:
    """What a preview shows.

    Args:
        data: The section's bytes, or those that a welcome carried.

    Returns:
        Gaussians, and the RGB behind them.

    Raises:
        BitstreamError: If the bytes are no preview.
    """
    preview = read_preview(data)
    red, green, blue = (value / 255 for value in preview.background)
    return preview.gaussians(), (red, green, blue)
