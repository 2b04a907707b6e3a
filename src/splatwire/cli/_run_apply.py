"""Implementation of `splatwire apply`: applies an update to a stream and writes the changed stream."""

from splatwire.bitstream import read_stream, write_stream
from splatwire.cli._files import STANDARD, input_path, output_path, refuse_own_input
from splatwire.cli._output import print_json, print_summary
from splatwire.cli.apply import Apply
from splatwire.codec import apply_update
from splatwire.errors import InvalidValueError


def run(command: Apply) -> None:
    """Runs `splatwire apply`: applies an update to a stream and writes the resulting stream."""
    if command.stream == command.update == STANDARD:
        raise InvalidValueError("the stream and its update cannot both be standard input")
    refuse_own_input(command.output, command.update)  # the stream itself may be replaced by its next state
    with input_path(command.stream) as first, input_path(command.update) as second:
        base, update = read_stream(first)[0], read_stream(second)[0]
    with output_path(command.output, expected_suffix=".swz", json=command.json) as path:
        changed = apply_update(base, update)
        write_stream(changed, path)
    if command.json:
        print_json({
            "output": command.output, "num_bytes": changed.num_bytes, "num_elements": changed.manifest.num_elements,
            "num_bytes_of_update": update.num_bytes,
        })  # fmt: skip
    else:
        text = f"{changed.manifest.num_elements:,} {changed.manifest.elements}, {changed.num_bytes:,} bytes"
        print_summary(f"{text}, of an update of {update.num_bytes:,} bytes -> {command.output}", command.output)
