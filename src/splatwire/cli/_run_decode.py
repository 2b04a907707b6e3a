"""Implementation of `splatwire decode`: decodes a received stream to a scene file or to frames."""

import time
from pathlib import Path

from splatwire.bitstream import ReadReport, SceneStream, read_stream
from splatwire.cli._concealers import check_concealer
from splatwire.cli._files import (
    check_folder_name,
    input_path,
    output_folder,
    output_path,
    read_report_json,
    refuse_own_input,
)
from splatwire.cli._output import print_json, print_summary, progress_bars
from splatwire.cli._scenes import chosen_outliers
from splatwire.cli.decode import Decode
from splatwire.codec import decode_stream
from splatwire.concealment import create_concealer
from splatwire.concealment.temporal.concealers import DEFAULT
from splatwire.errors import InvalidValueError
from splatwire.io import save_decoded
from splatwire.io.formats import format_for
from splatwire.sequence.written_frames import check_num_frames, write_frames
from splatwire.types.scene_digest import scene_digest


def run(options: Decode) -> None:
    """Runs `splatwire decode`: decodes a stream and writes the scene."""
    if options.conceal is not None:
        check_concealer(options.conceal)
    refuse_own_input(options.output, options.stream)
    with input_path(options.stream) as source:
        stream, report = read_stream(source)
    if stream.manifest.schema.timed:
        _decode_sequence(options, stream, report)
        return
    if (options.frame, options.format, options.max_frames) != (None, None, None):
        raise InvalidValueError(f"--frame, --max-frames and --format are for a clip, which {options.stream} is not")
    concealer = None if options.conceal is None else create_concealer(options.conceal)
    stream.require_static(options.stream)
    elements, explicit = stream.manifest.elements, stream.manifest.schema.explicit
    suffix = Path(options.output).suffix if explicit else ""
    if explicit:
        format_for(options.output)  # reports an unknown suffix before the work
    elif options.outliers is not None:
        raise InvalidValueError("--outliers is for explicit Gaussians")
    outliers = chosen_outliers(options.outliers, options.output)
    started = time.perf_counter()
    with progress_bars() as show, output_path(options.output, expected_suffix=suffix, json=options.json) as path:
        received = decode_stream(stream, progress=lambda share: show("decoding", share))
        decoded = time.perf_counter()
        written = save_decoded(received, concealer, path, outliers=outliers)
    count, num_lost = written.num_elements, received.loss_mask.num_lost
    if options.json:
        print_json(
            {
                "output": options.output,
                f"num_{elements.lower()}": count,
                "num_lost": num_lost,
                "digest": scene_digest(written.elements),
                "concealer": options.conceal,
                "seconds": decoded - started,
                "packets": read_report_json(report),
            }
        )
    else:
        text = f"{count - num_lost:,} of {count:,} {elements} arrived"
        print_summary(f"{text}, decoded in {decoded - started:.1f} s -> {options.output}", options.output)


def _decode_sequence(options: Decode, stream: SceneStream, report: ReadReport) -> None:
    """Decodes a clip, to one file per frame or to a single file."""
    folder = options.frame is None or not Path(options.output).suffix
    if not folder and options.format is not None:
        raise InvalidValueError("with --frame the file name sets the format: leave out --format")
    if options.frame is None:
        check_folder_name(options.output, "--frame writes one frame to a file")
    suffix = f".{(options.format or 'ply').lstrip('.')}" if folder else Path(options.output).suffix
    format_for(f"x{suffix}" if folder else options.output)
    outliers = chosen_outliers(options.outliers, f"x{suffix}" if folder else options.output)
    if options.frame is None:
        check_num_frames(stream, options.max_frames, "--max-frames allows more, --frame writes one")
    started, method = time.perf_counter(), options.conceal or DEFAULT
    output = (
        output_folder(options.output)
        if folder
        else output_path(options.output, expected_suffix=suffix, json=options.json)
    )
    with progress_bars() as show, output as path:
        facts = write_frames(stream, path, suffix, method, options.frame, show, outliers)
    seconds = time.perf_counter() - started
    if options.json:
        packets = read_report_json(report)
        print_json({"output": options.output, **facts, "concealer": method, "seconds": seconds, "packets": packets})
        return
    count, tracks = facts["num_frames"], facts["num_tracks"]
    text = f"{count} frame{'s' * (count != 1)} of {tracks:,} tracks, {report.num_missing:,} packets missing"
    print_summary(f"{text}, decoded in {seconds:.1f} s -> {options.output}", options.output)
