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
from splatwire.sequence.frame_writer import check_num_frames, write_frames
from splatwire.types.scene_digest import scene_digest


def run(command: Decode) -> None:
    """Runs `splatwire decode`: decodes a stream and writes the scene."""
    if command.conceal is not None:
        check_concealer(command.conceal)
    refuse_own_input(command.output, command.stream)
    with input_path(command.stream) as source:
        stream, report = read_stream(source)
    if stream.manifest.schema.timed:
        _decode_sequence(command, stream, report)
        return
    if (command.frame, command.format, command.max_frames) != (None, None, None):
        raise InvalidValueError(f"--frame, --max-frames and --format are for a clip, which {command.stream} is not")
    concealer = None if command.conceal is None else create_concealer(command.conceal)
    stream.require_static(command.stream)
    elements, explicit = stream.manifest.elements, stream.manifest.schema.explicit
    suffix = Path(command.output).suffix if explicit else ""
    if explicit:
        format_for(command.output)  # reports an unknown suffix before the work
    elif command.outliers is not None:
        raise InvalidValueError("--outliers is for explicit Gaussians")
    outliers = chosen_outliers(command.outliers, command.output)
    started = time.perf_counter()
    with progress_bars() as show, output_path(command.output, expected_suffix=suffix, json=command.json) as path:
        received = decode_stream(stream, progress=lambda share: show("decoding", share))
        decoded_at = time.perf_counter()
        concealed = save_decoded(received, concealer, path, outliers=outliers)
    count, num_lost = concealed.num_elements, received.loss_mask.num_lost
    if command.json:
        print_json(
            {
                "output": command.output,
                f"num_{elements.lower()}": count,
                "num_lost": num_lost,
                "digest": scene_digest(concealed.elements),
                "concealer": command.conceal,
                "seconds": decoded_at - started,
                "packets": read_report_json(report),
            }
        )
    else:
        text = f"{count - num_lost:,} of {count:,} {elements} arrived"
        print_summary(f"{text}, decoded in {decoded_at - started:.1f} s -> {command.output}", command.output)


def _decode_sequence(command: Decode, stream: SceneStream, report: ReadReport) -> None:
    """Decodes a clip, to one file per frame or to a single file."""
    folder = command.frame is None or not Path(command.output).suffix
    if not folder and command.format is not None:
        raise InvalidValueError("with --frame the file name sets the format: leave out --format")
    if command.frame is None:
        check_folder_name(command.output, "--frame writes one frame to a file")
    suffix = f".{(command.format or 'ply').lstrip('.')}" if folder else Path(command.output).suffix
    format_for(f"x{suffix}" if folder else command.output)
    outliers = chosen_outliers(command.outliers, f"x{suffix}" if folder else command.output)
    if command.frame is None:
        check_num_frames(stream, command.max_frames, "--max-frames of `decode` allows more, --frame writes one")
    started, method = time.perf_counter(), command.conceal or DEFAULT
    output = (
        output_folder(command.output)
        if folder
        else output_path(command.output, expected_suffix=suffix, json=command.json)
    )
    with progress_bars() as show, output as path:
        facts = write_frames(stream, path, suffix, method, command.frame, show, outliers)
    seconds = time.perf_counter() - started
    if command.json:
        packets = read_report_json(report)
        print_json({"output": command.output, **facts, "concealer": method, "seconds": seconds, "packets": packets})
        return
    count, tracks = facts["num_frames"], facts["num_tracks"]
    text = f"{count} frame{'s' * (count != 1)} of {tracks:,} tracks, {report.num_missing:,} packets missing"
    print_summary(f"{text}, decoded in {seconds:.1f} s -> {command.output}", command.output)
