"""Encoder options of sequences."""

from dataclasses import dataclass
from fractions import Fraction

from splatwire.arguments import check_fields, check_threads
from splatwire.bitstream.limits import MAX_FRAME_RATE, MAX_GROUP_FRAMES
from splatwire.codec.gaussians.quality import Quality, quality_of
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.types.background import BLACK, Background, check_background
from splatwire.types.metadata import UP_AXES

GROUP_FRAMES = 15
"""Default length of a group of pictures (GOP), frames. CONTRIBUTING.md lists the texts that
state it."""
FRAME_RATE = Fraction(30)
"""Default frame rate, frames per second."""
_MAX_DENOMINATOR = 1001
"""Maximum denominator of a frame rate that is not given as a fraction."""
FRAME_ORDERS = ("auto", "tracked", "shuffled")
"""Values of `SequenceOptions.order`."""


@dataclass(frozen=True)
class SequenceOptions:
    """Encoder options of a sequence.

    Attributes:
        rate: Frames per second. Numbers other than a `Fraction` are rounded to one with a denominator of up to 1001.
        group_frames: Length of a group of pictures (GOP) in frames. The loss of a motion packet affects at most this
            number of frames; a live stream is delayed by one group.
        order: Order of Gaussians: `tracked` if the i-th Gaussian is the same in all frames, `shuffled` if not, `auto`
            to detect it.
        quality: Quantisation quality: a name, a number from 0 to 100, or a `Quality`.
        background: Background colour, RGB.
        up: Up axis: `x`, `y` or `z`, with `-` for the negative direction; `auto` takes the axis that the
            frames state, or else estimates it from the first frame.
        threads: Number of threads; None for one per processor.

    Raises:
        InvalidValueError: If a value is out of range.
        UnknownNameError: If there is no such order, quality or axis.
    """

    rate: Fraction | int | float = FRAME_RATE
    group_frames: int = GROUP_FRAMES
    order: str = "auto"
    quality: str | int | float | Quality = "default"
    background: Background = BLACK
    up: str = "auto"
    threads: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "background", check_background(self.background))
        check_fields(self)
        check_threads(self.threads)
        quality_of(self.quality)
        if self.order not in FRAME_ORDERS:
            raise UnknownNameError("order of Gaussians", self.order, FRAME_ORDERS)
        if self.up not in ("auto", *UP_AXES):
            raise UnknownNameError("up axis", self.up, ("auto", *UP_AXES))
        rate = self.rate
        if not isinstance(rate, Fraction) and 0 < rate <= MAX_FRAME_RATE:
            rate = Fraction(float(rate)).limit_denominator(_MAX_DENOMINATOR)  # 0 if it is tiny
        if not 0 < rate <= MAX_FRAME_RATE:
            raise InvalidValueError(
                f"rate: clips have more than 0 and up to {MAX_FRAME_RATE} frames per second, not {float(self.rate):g}"
            )
        object.__setattr__(self, "rate", rate)
        if not 1 <= self.group_frames <= MAX_GROUP_FRAMES:
            raise InvalidValueError(f"a group has 1 to {MAX_GROUP_FRAMES} frames, not {self.group_frames}")


DEFAULT_OPTIONS = SequenceOptions()
"""Default encoder options."""
