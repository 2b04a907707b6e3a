"""Encoding of sequences (clips) with `splatwire encode`."""

import logging
import time
from dataclasses import replace
from pathlib import Path

from splatwire.bitstream import write_stream
from splatwire.cli._files import output_path
from splatwire.cli._output import print_json, print_summary, progress_bars
from splatwire.cli._scenes import chosen_background
from splatwire.cli._sequence_options import sequence_options
from splatwire.cli.encode import Encode
from splatwire.sequence import encode_sequence, open_sequence
from splatwire.sequence.description import describe_sequence

LOG = logging.getLogger(__name__)


def encode_sequence_of(command: Encode, source: Path) -> None:
    """Encodes frames as a clip, and prints the properties of the clip."""
    background = chosen_background(command.background)
    options = sequence_options(command.fps, command.group, command.quality, background, command.up)
    with progress_bars() as report, output_path(command.output, expected_suffix=".swz", json=command.json) as path:
        sequence, started = open_sequence(source, command.frames), time.perf_counter()
        if sequence.num_frames == 1 and source.is_dir():
            LOG.warning("%s: has one frame, of which a clip is made: name the file in it for a still", command.scene)
        if command.fps is None and sequence.rate is not None:
            options = replace(options, rate=sequence.rate)
        stream, tracking = encode_sequence(
            sequence.read(),
            replace(options, order=sequence.order),
            progress=lambda done: report("encoding frames", done / sequence.num_frames),
        )
        seconds = time.perf_counter() - started
        write_stream(stream, path)
    facts = describe_sequence(stream)
    if command.json:
        print_json({"output": command.output, "num_bytes": stream.num_bytes, **facts, "encoding_seconds": seconds})
        return
    how = f"{tracking.matched_share:.1%} matched" if tracking.num_matched_frames else "rows keep their Gaussians"
    text = f"{facts['frames']} frames of {facts['num_tracks']:,} tracks ({how}), {stream.num_bytes:,} bytes"
    print_summary(f"{text}, {seconds:.1f} s -> {command.output}", command.output)
