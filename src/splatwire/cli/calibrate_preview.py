"""`splatwire calibrate --method preview`: what a receiver sees of a scene from the first datagram on, in the stream."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatwire.cli._output import print_json, progress_bars
from splatwire.cli._scenes import chosen_background
from splatwire.cli.calibrate_sketch import SketchOptions, calibration_views, complete_stream
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.scene.background import Background
    from splatwire.train.calibrate_render import SketchViews


def calibrate_preview(options: SketchOptions) -> None:
    """Fits a preview, writes the stream with it, and prints what it costs and brings.

    Raises:
        InvalidValueError: If the output is no stream, or the options make no sense.
    """
    from splatwire.codec import add_concealment, decode_stream, without_concealment
    from splatwire.codec.preview import SECTION
    from splatwire.packets import write_stream
    from splatwire.train.calibrate_preview import PreviewConfig, preview_for_scene

    if options.output.suffix != ".swz":
        raise InvalidValueError(f"a preview travels in the stream: the output must end in .swz, not {options.output}")
    background, config = chosen_background(options.background), PreviewConfig(seed=options.seed)
    with progress_bars() as show:
        stream = complete_stream(options.source, show)
        partial = decode_stream(stream, progress=lambda share: show("decoding", share))
        if partial.erasures.num_lost:
            raise InvalidValueError("a preview is made of the complete scene, and of this one packets were lost")
        scene = partial.scene if background is None else replace(partial.scene, background=background)
        views, source = calibration_views(scene.anchors, options, scene.background)
        test = _test_photos(options.data, scene.background)
        result = preview_for_scene(scene, views, config, test=test, progress=show)
    bare = without_concealment(stream, SECTION)
    richer = add_concealment(bare, SECTION, result.section)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    write_stream(richer, options.output)
    report = {
        "output": str(options.output),
        "method": "preview",
        "views": source,
        "scored": "test photos" if test is not None else "the views it was fitted to",
        "num_bytes": richer.num_bytes - bare.num_bytes,
        "stream_bytes": richer.num_bytes,
        "preview_bytes": len(result.section),
        "num_gaussians": result.num_gaussians,
        "psnr": result.psnr,
        "seconds": result.seconds,
    }
    _print(report, as_json=options.json)


def _test_photos(data: Path | None, background: "Background") -> "SketchViews | None":
    """The test photos of a dataset."""
    from splatwire.data import open_dataset
    from splatwire.train.calibrate_render import SketchViews

    if data is None:
        return None
    photos = open_dataset(data, split="test", background=background)
    return SketchViews(photos.cameras, photos.image, background, photos.mask if photos.mask_paths else None)


def _print(report: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json(report)
        return
    print(f"fitted {report['views']}; PSNR in {report['scored']}")
    for name, value in report["psnr"].items():
        print(f"  {name:<10} {value:6.2f} dB")
    size, total = report["preview_bytes"], report["stream_bytes"]
    print(f"{report['num_gaussians']} Gaussians in {size:,} bytes, {report['seconds']:,.0f} s")
    print(f"{report['num_bytes']:,} bytes more in a stream of {total:,} -> {report['output']}")
