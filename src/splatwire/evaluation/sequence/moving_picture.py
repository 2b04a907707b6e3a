"""Moving picture of a sequence: an animated WebP."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from PIL import Image

from splatwire.bitstream import SceneStream
from splatwire.bitstream.sections import sections_of
from splatwire.codec import decode_stream
from splatwire.codec.initial_view import read_extent, up_axis
from splatwire.concealment.temporal.concealers import DEFAULT, temporal_concealer
from splatwire.errors import InvalidValueError
from splatwire.evaluation.pixels import to_pixels
from splatwire.files.atomic_write import atomic_output
from splatwire.render import iterate_views
from splatwire.render.importance import orbiting_cameras
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.sequence.decoding import decode_frames
from splatwire.sequence.extent import sphere_around
from splatwire.types import Cameras

Report = Callable[[str, float], None]
MAX_PICTURE_BYTES = 4 << 30
"""Maximum size of all pictures before compression, bytes; the writer of WebP keeps them in memory."""


def draw_sequence(
    stream: SceneStream, path: Path, cameras: Cameras | None, scale: float, concealer: str | None, renderer: str,
    report: Report,
) -> dict[str, Any]:  # fmt: skip
    """Renders a sequence as an animated WebP file; returns the number of frames and their size in pixels.

    Args:
        stream: The sequence.
        path: Path of the output file.
        cameras: Cameras, which follow each other at equal intervals over the sequence; None for a circular path around
            the scene.
        scale: Factor on the picture size.
        concealer: Name of the concealer of lost motion; None for the default.
        renderer: Name of the renderer.
        report: Called with the name of the current task and its finished share, 0 to 1.

    Raises:
        UnknownNameError: If there is no such concealer or renderer.
        InvalidValueError: If the pictures take more than `MAX_PICTURE_BYTES`.
    """
    method = temporal_concealer(concealer or DEFAULT)
    sequence = decode_stream(stream, progress=lambda share: report("decoding packets", share)).scene
    count = sequence.timeline.num_frames
    given = cameras is not None
    if cameras is None:
        sections, born = sections_of(stream), sphere_around(sequence.positions)
        middle, radius = read_extent(sections) or (born.middle, born.radius)
        cameras = orbiting_cameras(middle, max(radius, 1e-6), count, up_axis(sections))
        cameras = replace(cameras, origin=sequence.origin)
    cameras = cameras if scale == 1 else cameras.scaled(scale)
    num_bytes = 3 * cameras.width * cameras.height * count
    if num_bytes > MAX_PICTURE_BYTES:
        raise InvalidValueError(
            f"the clip has {count:,} frames, and pictures of {cameras.width} x {cameras.height} pixels would take "
            f"{num_bytes / 1e9:.1f} GB, more than {MAX_PICTURE_BYTES / 1e9:.1f} GB: choose a smaller --scale, or "
            "render frames that `decode --frame` writes"
        )

    def pictures() -> Iterator[Image.Image]:
        for frame in decode_frames(sequence, method):
            if given and frame.number == 0:
                warn_of_near_plane(frame.scene, cameras)
            view = cameras.select([frame.number * cameras.num_views // count])
            image = next(iter(iterate_views(frame.scene, view, renderer=renderer)))
            report("drawing", (frame.number + 1) / count)
            yield Image.fromarray(to_pixels(image))

    drawn, times = pictures(), [round(number * 1000 / sequence.timeline.rate) for number in range(count + 1)]
    durations = [after - before for before, after in itertools.pairwise(times)]
    with atomic_output(path) as target:
        next(drawn).save(
            target, "WEBP", save_all=True, append_images=drawn, duration=durations, loop=0, quality=85, method=2
        )
    return {"num_frames": count, "width": cameras.width, "height": cameras.height}
