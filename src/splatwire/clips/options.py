"""How a clip is encoded."""

from dataclasses import dataclass
from fractions import Fraction

from splatwire.codec.schemas.gaussians.quality import Quality
from splatwire.errors import InvalidValueError
from splatwire.packets.limits import MAX_FRAME_RATE, MAX_GROUP_FRAMES
from splatwire.scene.background import BLACK, Background

GROUP_FRAMES = 15
FRAME_RATE = Fraction(30)


@dataclass(frozen=True)
class ClipOptions:
    """How a clip is encoded.

    Attributes:
        rate: Frames a second.
        group_frames: Frames of a group: what a lost packet of motion takes, and how long a live viewer waits. One, but
            for live clips, where most of the first frames show another scene than the one before.
        order: Whether rows are the same Gaussians in every frame, see `Tracker`.
        quality: How finely Gaussians are quantised: a name, or a `Quality`.
        background: RGB behind everything.
        up: Which axis points up: `y`, `-y`, `z`, `-z`; `auto` looks at the first frame (`splatwire.render.up`).
        threads: Threads to use, which changes no bit; None for one for each processor.

    Raises:
        InvalidValueError: If rate or group are out of range.
    """

    rate: Fraction = FRAME_RATE
    group_frames: int = GROUP_FRAMES
    order: str = "auto"
    quality: str | Quality = "default"
    background: Background = BLACK
    up: str = "auto"
    threads: int | None = None

    def __post_init__(self) -> None:
        if not 0 < self.rate <= MAX_FRAME_RATE:
            raise InvalidValueError(f"a clip has up to {MAX_FRAME_RATE} frames a second, not {float(self.rate):g}")
        if not 1 <= self.group_frames <= MAX_GROUP_FRAMES:
            raise InvalidValueError(f"a group has 1 to {MAX_GROUP_FRAMES} frames, not {self.group_frames}")


USUAL = ClipOptions()
"""How a clip is encoded unless somebody asks for something else."""
