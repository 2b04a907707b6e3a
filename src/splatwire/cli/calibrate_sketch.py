"""`splatwire calibrate --method sketch`: coarse copies of important anchors, chosen on pictures, in the stream."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from splatwire.cli._files import is_stream
from splatwire.cli._output import Reporter, print_json, progress_bars
from splatwire.cli._scenes import BackgroundOption, chosen_background
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.packets import SceneStream
    from splatwire.scene import Anchors
    from splatwire.scene.background import Background
    from splatwire.train.calibrate_render import SketchViews


@runtime_checkable
class SketchOptions(Protocol):
    """The options of `splatwire calibrate` that a sketch heeds; properties, so that a frozen class will do."""

    @property
    def source(self) -> Path:
        """Complete stream, or scene file."""

    @property
    def output(self) -> Path:
        """Stream to write."""

    @property
    def data(self) -> Path | None:
        """Folder of posed photos."""

    @property
    def cameras(self) -> Path | None:
        """Cameras file, where there are no photos."""

    @property
    def share(self) -> float:
        """Bytes of the sketch over those of the stream."""

    @property
    def drop_rate(self) -> float:
        """Share of packets that a pseudo-loss takes."""

    @property
    def background(self) -> BackgroundOption:
        """RGB behind everything; None for the scene's own."""

    @property
    def seed(self) -> int:
        """Seed of everything random."""

    @property
    def json(self) -> bool:
        """Whether to print JSON."""


def calibrate_sketch(options: SketchOptions) -> None:
    """Makes a sketch, writes the stream with it, and prints what it costs and brings.

    Raises:
        InvalidValueError: If the output is no stream, or the options make no sense.
    """
    from splatwire.codec import add_concealment, decode_stream, without_concealment
    from splatwire.conceal.sketch import SECTION
    from splatwire.packets import write_stream
    from splatwire.train.calibrate_render import SketchConfig, sketch_for_stream
    from splatwire.train.gnn_data import calibration_data

    if options.output.suffix != ".swz":
        raise InvalidValueError(f"a sketch travels in the stream: the output must end in .swz, not {options.output}")
    background = chosen_background(options.background)
    config = SketchConfig(share=options.share, drop_rate=options.drop_rate, seed=options.seed)
    with progress_bars() as show:
        stream = complete_stream(options.source, show)
        data = calibration_data(stream, decode_stream(stream, progress=lambda share: show("decoding", share)))
        behind = data.scene.background if background is None else background
        views, source = calibration_views(data.context.anchors, options, behind)
        bare = without_concealment(stream, SECTION)
        result = sketch_for_stream(data, views, bare.num_bytes, config, progress=show)
    richer = add_concealment(bare, SECTION, result.section)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    write_stream(richer, options.output)
    report = {
        "output": str(options.output),
        "method": "sketch",
        "views": source,
        "num_bytes": richer.num_bytes - bare.num_bytes,
        "stream_bytes": richer.num_bytes,
        "share_of_stream": (richer.num_bytes - bare.num_bytes) / richer.num_bytes,
        "num_anchors": bare.manifest.num_anchors,
        "num_sketched": result.num_sketched,
        "growth_exponent": result.exponent,
        "growth_trust": result.trust,
        "psnr_held_out": result.psnr,
        "seconds": result.seconds,
    }
    _print(report, as_json=options.json)


def _print(report: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json(report)
        return
    print(f"PSNR on held-out losses, {report['views']}")
    for name, value in report["psnr_held_out"].items():
        print(f"  {name:<8} {value:6.2f} dB")
    print(f"{report['num_sketched']:,} of {report['num_anchors']:,} anchors sketched, {report['seconds']:,.0f} s")
    size, total, share = report["num_bytes"], report["stream_bytes"], 100 * report["share_of_stream"]
    print(f"{size:,} bytes in a stream of {total:,} ({share:.2f} %) -> {report['output']}")


def complete_stream(source: Path, show: Reporter) -> "SceneStream":
    """The stream that a person named; a scene is encoded first."""
    from splatwire.codec import encode_scene
    from splatwire.model.scene_file import load_scene
    from splatwire.packets import PRESETS, read_stream

    if is_stream(source):
        return read_stream(source)[0]
    return encode_scene(load_scene(source), PRESETS["paper"], progress=lambda share: show("encoding", share))


def calibration_views(
    anchors: "Anchors", options: SketchOptions, background: "Background"
) -> "tuple[SketchViews, str]":
    """Where a scene is looked at from: training photos, cameras, or a sphere of views; and which of them, in words.

    Raises:
        InvalidValueError: If photos and cameras were given.
    """
    from splatwire.data import load_cameras, open_dataset
    from splatwire.render.importance import surrounding_cameras
    from splatwire.train.calibrate_render import SketchViews

    if options.data is not None and options.cameras is not None:
        raise InvalidValueError("give --data or --cameras, not both: photos have their own cameras")
    if options.data is not None:
        photos = open_dataset(options.data, split="train", background=background)
        mask = photos.mask if photos.mask_paths else None
        where = "against training photos inside their masks" if mask else "against training photos"
        return SketchViews(photos.cameras, photos.image, background, mask), where
    if options.cameras is not None:
        cameras = load_cameras(options.cameras)
        return SketchViews(cameras, None, background), "against the complete scene in the cameras given"
    cameras = surrounding_cameras(anchors)
    return SketchViews(cameras, None, background), "against the complete scene on a sphere of views"
