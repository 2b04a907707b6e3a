"""Implementation of `splatwire render`: renders a scene to image files."""

import time
from pathlib import Path

from splatwire.bitstream import SceneStream, is_stream, read_stream
from splatwire.cli._files import check_folder, input_path, prepared_output
from splatwire.cli._output import print_json, print_summary, progress_bars
from splatwire.cli._scenes import chosen_background
from splatwire.cli.render import Render
from splatwire.concealment import create_concealer
from splatwire.data import load_cameras, open_dataset, save_cameras
from splatwire.data.camera_file import FORMAT
from splatwire.errors import InvalidValueError
from splatwire.evaluation.pixels import png_bytes, to_pixels
from splatwire.evaluation.sequence.moving_picture import draw_sequence
from splatwire.files.atomic_write import atomic_files
from splatwire.files.names import distinct_names
from splatwire.io import drawable_scene
from splatwire.render import iterate_views
from splatwire.render.framing import framing_cameras
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.types import Cameras
from splatwire.types.background import Background

_NUM_VIEWS = 12
"""Number of views around a scene without cameras."""
_VIEW_SIZE = 512
"""Width and height of these views, pixels."""
_CAMERAS_NAME = "cameras.json"
"""Name of the cameras file beside the pictures."""
_INSTEAD = (
    "name a folder; `thumb` draws one picture, and a clip, which `encode` makes of files of Gaussians, becomes a "
    "moving picture (.webp)"
)
"""Hint for users who want a file of a still scene."""
_HEAD_BYTES = 200
"""Number of bytes at the beginning of a cameras file that state its format."""


def run(command: Render) -> None:
    """Runs `splatwire render`: draws a scene from cameras into picture files."""
    cameras = find_cameras(command.cameras, command.data)
    if not 0 < command.scale <= 16:
        raise InvalidValueError(f"--scale must be above 0 and at most 16, not {command.scale:g}")

    background = chosen_background(command.background)
    with input_path(command.scene) as source:
        if is_stream(source) and (stream := read_stream(source)[0]).manifest.schema.timed:
            _draw_sequence(command, stream, cameras)
        else:
            _draw_scene(command, source, cameras, background)


def _draw_sequence(command: Render, stream: SceneStream, cameras: Cameras | None) -> None:
    if command.output.suffix.lower() != ".webp":
        raise InvalidValueError(f"a clip becomes a moving picture: give a name such as name.webp, not {command.output}")
    prepared_output(command.output, expected_suffix=".webp")
    if command.background is not None:
        raise InvalidValueError("--background is for still scenes; a clip has the background that `encode` stored")
    started = time.perf_counter()
    with progress_bars() as show:
        facts = draw_sequence(stream, command.output, cameras, command.scale, command.conceal, command.renderer, show)
    seconds = time.perf_counter() - started
    if command.json:
        print_json({"output": str(command.output), **facts, "seconds": seconds})
    else:
        print_summary(f"{facts['num_frames']} frames in {seconds:.1f} s -> {command.output}")


def _draw_scene(command: Render, source: Path, cameras: Cameras | None, background: Background | None) -> None:
    concealer = create_concealer(command.conceal or "drop")
    check_folder(command.output, _INSTEAD)
    _check_earlier_cameras(command.output / _CAMERAS_NAME)
    scene, num_lost = drawable_scene(source, concealer)
    if cameras is None:
        cameras = framing_cameras(scene, _NUM_VIEWS, _VIEW_SIZE)
    warn_of_near_plane(scene, cameras)
    cameras = cameras if command.scale == 1 else cameras.scaled(command.scale)
    started, files = time.perf_counter(), [f"{name}.png" for name in distinct_names(cameras.names, "view")]
    with progress_bars() as show:
        images = iterate_views(scene, cameras, renderer=command.renderer, background=background)
        with atomic_files(command.output, last=_CAMERAS_NAME) as folder:
            for view, image in enumerate(images):
                (folder / files[view]).write_bytes(png_bytes(to_pixels(image)))
                show("drawing", (view + 1) / cameras.num_views)
            save_cameras(cameras, folder / _CAMERAS_NAME)
    seconds = time.perf_counter() - started
    if command.json:
        print_json(
            {
                "output": str(command.output),
                "pictures": files,
                "num_views": cameras.num_views,
                "width": cameras.width,
                "height": cameras.height,
                f"num_{scene.ELEMENTS.lower()}": scene.num_elements,
                "num_lost": num_lost,
                "seconds": seconds,
            }
        )
    else:
        size = f"{cameras.width} x {cameras.height}"
        print_summary(f"{cameras.num_views} pictures of {size} in {seconds:.1f} s -> {command.output}")


def _check_earlier_cameras(path: Path) -> None:
    """Checks that the cameras file of other programs, such as that of a 3DGS model, is not replaced.

    Raises:
        InvalidValueError: If there is such a file.
    """
    if path.is_file():
        with path.open("rb") as file:
            if FORMAT.encode() not in file.read(_HEAD_BYTES):
                raise InvalidValueError(f"{path} was not written by splatwire and would be lost: name another folder")


def find_cameras(cameras: Path | None, data: Path | None) -> Cameras | None:
    """Reads a cameras file, or the test cameras of a dataset; returns None if neither is given.

    Raises:
        InvalidValueError: If both a cameras file and a dataset are given.
        DatasetError: If the file or dataset cannot be read.
    """
    if cameras is not None and data is not None:
        raise InvalidValueError("give either --cameras FILE or --data FOLDER")
    if cameras is not None:
        return load_cameras(cameras)
    return None if data is None else open_dataset(data, split="test").cameras
