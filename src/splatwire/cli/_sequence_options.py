"""Encoder options of a clip, for `splatwire encode` and `splatwire live`."""

from splatwire.cli._options import quality_option
from splatwire.codec.gaussians.quality import quality_of
from splatwire.errors import InvalidValueError
from splatwire.sequence.options import FRAME_RATE, GROUP_FRAMES, SequenceOptions
from splatwire.types.background import BLACK, Background


def sequence_options(
    fps: float | None, group: int | None, quality: str | None, background: Background | None, up: str = "auto"
) -> SequenceOptions:
    """Returns the encoder options of a clip.

    Args:
        fps: Frames per second; None for the default.
        group: Frames per group of pictures; None for the default.
        quality: Value of `--quality`; None for the default.
        background: RGB of the background; None for black.
        up: Value of `--up`: the up axis, or `auto`.

    Raises:
        InvalidValueError: If a number is out of range.
        UnknownNameError: If there is no such quality.
    """
    if fps is not None and not 0.01 <= fps <= 1000:
        raise InvalidValueError(f"--fps takes 0.01 to 1000 frames per second, not {fps:g}")
    return SequenceOptions(
        FRAME_RATE if fps is None else fps, GROUP_FRAMES if group is None else group,
        quality=quality_of(quality_option(quality or "default")),
        background=BLACK if background is None else background, up=up,
    )  # fmt: skip
