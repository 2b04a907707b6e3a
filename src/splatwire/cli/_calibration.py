"""Common code of `calibrate`: reads the stream, chooses views for image comparison, and writes the changed stream."""

import sys
from pathlib import Path

from splatwire.bitstream import SceneStream, is_stream, read_stream, write_stream
from splatwire.calibration.sketch import sketch_of
from splatwire.calibration.sketch_config import QUICK
from splatwire.calibration.views import CalibrationViews
from splatwire.cli._files import check_inputs, prepared_output
from splatwire.cli._output import Reporter
from splatwire.cli._scenes import chosen_background
from splatwire.cli.calibrate import ReferenceOptions
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.concealment.sketch import SECTION
from splatwire.data import load_cameras, open_dataset
from splatwire.errors import InvalidValueError
from splatwire.io import open_scene
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import scene_class_offsets
from splatwire.types import Cameras
from splatwire.types.background import Background
from splatwire.types.scene import Scene


def check_references(options: ReferenceOptions) -> None:
    """Checks the options about reference pictures, before files are read.

    Raises:
        InvalidValueError: If both photos and cameras are given, one of these paths does not exist, or the background is
            not a colour.
    """
    if options.data is not None and options.cameras is not None:
        raise InvalidValueError("give --data or --cameras, not both: photos have their own cameras")
    chosen_background(options.background)
    check_inputs(options.data, options.cameras)


def calibration_views(options: ReferenceOptions, scene: Scene) -> tuple[CalibrationViews, str]:
    """Returns the views in which a calibration compares pictures, and a description of these views for messages.

    Args:
        options: Command-line options that select the reference pictures.
        scene: The complete scene.
    """
    background = _reference_background(options, scene)
    if (photos := photos_of(options, "train", scene)) is not None:
        return photos, f"against training photos{'' if photos.mask is None else ' inside their masks'}"
    if options.cameras is not None:
        views = CalibrationViews(load_cameras(options.cameras), background=background)
        return views, "against the complete scene in the cameras given"
    around = CalibrationViews(surrounding_cameras(scene), background=background)
    return around, "against the complete scene on a sphere of views"


def photos_of(options: ReferenceOptions, split: str, scene: Scene) -> CalibrationViews | None:
    """Returns the photos of a dataset with their cameras; None if no dataset was given with the option `--data`.

    Args:
        options: Command-line options that select the reference pictures.
        split: `train` or `test`.
        scene: The scene, for the background of its training.
    """
    if options.data is None:
        return None
    photos = open_dataset(options.data, split=split, background=_reference_background(options, scene))
    return CalibrationViews.of_photos(photos)


def _reference_background(options: ReferenceOptions, scene: Scene) -> Background:
    """Returns the background colour of the reference pictures: that of --background if given, else the scene's own."""
    chosen = chosen_background(options.background)
    return scene.background if chosen is None else chosen


def stream_output(path: Path, addition: str) -> Path:
    """Checks that the output path of a calibration is a stream that can be written, and returns the path.

    Args:
        path: The path.
        addition: Name of the addition to the stream, such as `sketch`, for the message.

    Raises:
        InvalidValueError: If the file name suffix is not that of a stream, or the file cannot be written.
    """
    if path.suffix != ".swz":
        raise InvalidValueError(f"a {addition} travels in the stream: the output must end in .swz, not {path}")
    return prepared_output(path)


def complete_stream(source: Path, show: Reporter) -> SceneStream:
    """Reads the stream to which a calibration adds data; encodes a scene file first.

    Args:
        source: Path of the stream or scene file.
        show: Called with the name of the current task and its finished share, 0 to 1.
    """
    if is_stream(source):
        return read_stream(source)[0].require_static(source)
    scene = open_scene(source)
    return encode_scene(scene, class_offsets=scene_class_offsets(scene), progress=lambda share: show("encoding", share))


def with_quick_sketch(stream: SceneStream, cameras: Cameras | None, show: Reporter) -> SceneStream:
    """Adds coarse copies of important elements (a sketch) to a stream.

    If no sketch can be made, prints the reason and returns the stream unchanged.

    Args:
        stream: The complete stream.
        cameras: Views in which the importance of elements is measured; None for views around the scene.
        show: Called with the name of the current task and its finished share, 0 to 1.
    """
    complete = decode_stream(stream)
    if cameras is None:
        cameras = surrounding_cameras(complete.scene, QUICK.views, QUICK.width)
    try:
        made = sketch_of(stream, complete, CalibrationViews(cameras), QUICK, progress=show)
    except InvalidValueError as reason:
        print(f"without a sketch: {reason}", file=sys.stderr)
        return stream
    return with_section(stream, SECTION, made.section)


def write_with_section(stream: SceneStream, name: str, section: bytes, path: Path) -> dict[str, int | float]:
    """Writes a stream with an additional named section of side information, and returns the resulting sizes.

    Args:
        stream: The stream without the section.
        name: Name of the section.
        section: Content of the section.
        path: Output path.

    Returns:
        Mapping with `num_bytes` (size of the section), `stream_bytes` (size of the stream with the section) and
        `share_of_stream` (their ratio).
    """
    richer = with_section(stream, name, section)
    write_stream(richer, path)
    size = richer.num_bytes - stream.num_bytes
    return {"num_bytes": size, "stream_bytes": richer.num_bytes, "share_of_stream": size / richer.num_bytes}
