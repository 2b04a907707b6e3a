"""Implementation of `splatwire calibrate`: adds a sketch or preview to a stream."""

from typing import Any

from splatwire.bitstream import SceneStream
from splatwire.calibration.preview import PreviewConfig, preview_for_scene
from splatwire.calibration.sketch import sketch_of
from splatwire.calibration.sketch_config import SketchConfig
from splatwire.cli._calibration import (
    calibration_views,
    check_references,
    complete_stream,
    photos_of,
    stream_output,
    write_with_section,
)
from splatwire.cli._output import Reporter, print_json, progress_bars
from splatwire.cli.calibrate import Calibrate, CalibrateGnn, CalibratePreview, CalibrateSketch
from splatwire.codec import decode_stream, without_section
from splatwire.codec.preview import SECTION as PREVIEW
from splatwire.concealment.sketch import SECTION as SKETCH
from splatwire.errors import InvalidValueError
from splatwire.types import ReceivedScene


def run(command: Calibrate) -> None:
    """Runs `splatwire calibrate`: adds a network, coarse copies (sketch) or a preview to a stream."""
    addition = command.addition
    if isinstance(addition, CalibrateGnn):
        from splatwire.cli import _run_calibrate_gnn  # imports torch

        _run_calibrate_gnn.run(addition)
    elif isinstance(addition, CalibrateSketch):
        _sketch(addition)
    else:
        _preview(addition)


def _read_and_decode(command: CalibrateSketch | CalibratePreview, show: Reporter) -> tuple[SceneStream, ReceivedScene]:
    """Reads the stream that is to be calibrated, and decodes the scene."""
    stream = complete_stream(command.source, show)
    return stream, decode_stream(stream, progress=lambda share: show("decoding", share))


def _sketch(command: CalibrateSketch) -> None:
    output = stream_output(command.output, "sketch")
    config = SketchConfig(share=command.share, drop_rate=command.drop_rate, seed=command.seed)
    check_references(command.reference_pictures)
    with progress_bars() as show:
        stream, complete = _read_and_decode(command, show)
        views, where = calibration_views(command.reference_pictures, complete.scene)
        bare = without_section(stream, SKETCH)
        result = sketch_of(bare, complete, views, config, progress=show)
    sizes = write_with_section(bare, SKETCH, result.section, output)
    report = {
        "output": str(command.output),
        "views": where,
        **sizes,
        "elements": bare.manifest.elements,
        "num_elements": bare.manifest.num_elements,
        "num_sketched": result.num_sketched,
        "growth_exponent": result.exponent,
        "growth_trust": result.trust,
        "psnr_held_out": result.psnr,
        "seconds": result.seconds,
    }
    print_json(report) if command.json else _print_sketch(report)


def _print_sketch(report: dict[str, Any]) -> None:
    _print_psnr(f"PSNR on held-out losses, {report['views']}", report["psnr_held_out"], 8)
    sketched, number, elements = report["num_sketched"], report["num_elements"], report["elements"]
    print(f"{sketched:,} of {number:,} {elements} sketched, {report['seconds']:,.0f} s")
    size, total, share = report["num_bytes"], report["stream_bytes"], 100 * report["share_of_stream"]
    print(f"{size:,} bytes in a stream of {total:,} ({share:.2f} %) -> {report['output']}")


def _preview(command: CalibratePreview) -> None:
    output, config = stream_output(command.output, "preview"), PreviewConfig(seed=command.seed)
    check_references(command.reference_pictures)
    with progress_bars() as show:
        stream, received = _read_and_decode(command, show)
        if received.loss_mask.num_lost:
            raise InvalidValueError("a preview needs the complete scene; packets were lost from this stream")
        views, where = calibration_views(command.reference_pictures, received.scene)
        test = photos_of(command.reference_pictures, "test", received.scene)
        result = preview_for_scene(received.scene, views, config, test=test, progress=show)
    sizes = write_with_section(without_section(stream, PREVIEW), PREVIEW, result.section, output)
    report = {
        "output": str(command.output),
        "views": where,
        "scored": "test photos" if test is not None else "the views it was fitted to",
        **sizes,
        "preview_bytes": len(result.section),
        "num_gaussians": result.num_gaussians,
        "psnr": result.psnr,
        "seconds": result.seconds,
    }
    print_json(report) if command.json else _print_preview(report)


def _print_preview(report: dict[str, Any]) -> None:
    _print_psnr(f"fitted {report['views']}; PSNR in {report['scored']}", report["psnr"], 10)
    size, total = report["preview_bytes"], report["stream_bytes"]
    print(f"{report['num_gaussians']} Gaussians in {size:,} bytes, {report['seconds']:,.0f} s")
    print(f"{report['num_bytes']:,} bytes more in a stream of {total:,} -> {report['output']}")


def _print_psnr(title: str, values: dict[str, float], width: int) -> None:
    print(title)
    for name, value in values.items():
        print(f"  {name:<{width}} {value:6.2f} dB")
