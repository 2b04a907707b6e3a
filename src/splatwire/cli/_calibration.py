"""What calibrations share: the stream that they start from, where they look from, the section that they add."""

import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._files import check_inputs, is_stream, prepared_output
from splatwire.cli._output import JsonFlag, Reporter
from splatwire.cli._scenes import BackgroundOption, chosen_background
from splatwire.errors import InvalidValueError, how_to_install

if TYPE_CHECKING:
    from splatwire.calibrate.views import CalibrationViews
    from splatwire.model.appearance import Scene
    from splatwire.packets import SceneStream
    from splatwire.scene import Cameras
    from splatwire.scene.background import Background


@dataclass(frozen=True)
class LookFrom:
    """Where pictures are compared; without photos and cameras on a sphere of views, with the complete scene."""

    data: Path | None = None
    """Posed photos, of which the training views are used."""
    cameras: Path | None = None
    """Cameras file: the complete scene's pictures there instead of photos."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind everything; what the scene was trained in front of where absent."""

    def check(self) -> None:
        """Refuses what contradicts itself, before any work.

        Raises:
            InvalidValueError: If photos and cameras were given, one is not there, or the background is no colour.
        """
        if self.data is not None and self.cameras is not None:
            raise InvalidValueError("give --data or --cameras, not both: photos have their own cameras")
        chosen_background(self.background)
        check_inputs(self.data, self.cameras)

    def views(self, scene: "Scene") -> "tuple[CalibrationViews, str]":
        """Training photos, cameras, or a sphere of views; and which of them, in words."""
        from splatwire.calibrate.views import CalibrationViews
        from splatwire.data import load_cameras
        from splatwire.model.appearance import origin_of
        from splatwire.render.importance import surrounding_cameras

        behind = self._behind(scene)
        if (photos := self.photos("train", scene)) is not None:
            return photos, f"against training photos{'' if photos.mask is None else ' inside their masks'}"
        if self.cameras is not None:
            cameras = load_cameras(self.cameras).relative_to(origin_of(scene))
            there = CalibrationViews(cameras, background=behind)
            return there, "against the complete scene in the cameras given"
        around = CalibrationViews(surrounding_cameras(scene), background=behind)
        return around, "against the complete scene on a sphere of views"

    def photos(self, split: str, scene: "Scene") -> "CalibrationViews | None":
        """The photos of a split, `train` or `test`; None without photos."""
        from splatwire.calibrate.views import CalibrationViews
        from splatwire.data import open_dataset
        from splatwire.model.appearance import origin_of

        if self.data is None:
            return None
        photos = open_dataset(self.data, split=split, background=self._behind(scene))
        views = CalibrationViews.of_photos(photos)
        return replace(views, cameras=views.cameras.relative_to(origin_of(scene)))

    def _behind(self, scene: "Scene") -> "Background":
        chosen = chosen_background(self.background)
        return scene.background if chosen is None else chosen


@dataclass(frozen=True)
class StreamCalibration:
    """The options of a calibration that looks at pictures and writes a stream."""

    source: tyro.conf.Positional[Path]
    """Complete stream, or scene file (it is encoded first)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Stream to write (.swz)."""
    look: LookFrom = field(default_factory=LookFrom)
    seed: int = 0
    """Seed of everything random."""
    json: JsonFlag = False
    """Print one JSON object."""


def stream_output(path: Path, what: str) -> Path:
    """Checks the name of a stream to write.

    Raises:
        InvalidValueError: If it is no stream's name, or nothing can be written under it.
    """
    if path.suffix != ".swz":
        raise InvalidValueError(f"a {what} travels in the stream: the output must end in .swz, not {path}")
    return prepared_output(path)


def complete_stream(source: Path, show: Reporter) -> "SceneStream":
    """The stream that a person named; a scene is encoded first."""
    from splatwire.codec import encode_scene
    from splatwire.packets import read_stream
    from splatwire.render.precision import classes_of
    from splatwire.scene_io import open_scene

    if is_stream(source):
        return read_stream(source)[0].still(source)
    scene = open_scene(source)
    return encode_scene(scene, classes=classes_of(scene), progress=lambda share: show("encoding", share))


def with_quick_sketch(stream: "SceneStream", cameras: "Cameras | None", show: Reporter) -> "SceneStream":
    """Returns the stream with a sketch that takes no longer than encoding.

    Where none fits, or torch is not installed, the stream is returned as it is, with a line on standard error.

    Args:
        stream: The complete stream.
        cameras: Where the scene is looked at from; None for views around it.
        show: Called with what is done and the share of it that is done.
    """
    try:
        from splatwire.calibrate.sketch import sketch_of
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        print(f"without a sketch: {how_to_install(error.name)}", file=sys.stderr)
        return stream
    from splatwire.calibrate.sketch_config import QUICK
    from splatwire.calibrate.views import CalibrationViews
    from splatwire.codec import add_concealment, decode_stream
    from splatwire.conceal.sketch import SECTION
    from splatwire.render.importance import surrounding_cameras

    complete = decode_stream(stream)
    if cameras is None:
        cameras = surrounding_cameras(complete.scene, QUICK.views, QUICK.width)
    try:
        made = sketch_of(stream, complete, CalibrationViews(cameras), QUICK, progress=show)
    except InvalidValueError as reason:
        print(f"without a sketch: {reason}", file=sys.stderr)
        return stream
    return add_concealment(stream, SECTION, made.section)


def write_with_section(bare: "SceneStream", name: str, section: bytes, path: Path) -> dict[str, int | float]:
    """Writes a stream with a section more, and says what that costs.

    Args:
        bare: The stream without it.
        name: Its name.
        section: Its bytes.
        path: Where to write.

    Returns:
        `num_bytes` that it takes, `stream_bytes` of all, and `share_of_stream`.
    """
    from splatwire.codec import add_concealment
    from splatwire.packets import write_stream

    richer = add_concealment(bare, name, section)
    write_stream(richer, path)
    size = richer.num_bytes - bare.num_bytes
    return {"num_bytes": size, "stream_bytes": richer.num_bytes, "share_of_stream": size / richer.num_bytes}
