"""Implementation of `splatwire thumb`: writes a picture of a scene."""

from splatwire.bitstream import is_stream, read_stream
from splatwire.cli._files import input_path, prepared_output
from splatwire.cli._output import print_json, print_summary
from splatwire.cli.thumb import Thumb
from splatwire.concealment import create_concealer
from splatwire.errors import InvalidValueError
from splatwire.evaluation.thumbnail import MAX_SIDE, check_suffix, picture_bytes, stream_thumbnail, thumbnail
from splatwire.files.atomic_write import atomic_write
from splatwire.io import drawable_scene


def run(command: Thumb) -> None:
    """Runs `splatwire thumb`: draws one picture of a scene."""
    check_suffix(command.output)
    if not all(1 <= side <= MAX_SIDE for side in command.size):
        raise InvalidValueError(f"--size takes a width and a height from 1 to {MAX_SIDE} pixels")
    prepared_output(command.output)
    with input_path(command.scene) as path:
        if is_stream(path):
            stream = read_stream(path)[0]
            pixels = stream_thumbnail(
                stream if stream.manifest.schema.timed else stream.require_static(command.scene), command.size
            )
        else:
            pixels = thumbnail(drawable_scene(path, create_concealer("drop"))[0], command.size)
    atomic_write(command.output, picture_bytes(pixels, command.output.suffix))
    width, height = command.size
    num_bytes = command.output.stat().st_size
    if command.json:
        print_json({"output": str(command.output), "width": width, "height": height, "num_bytes": num_bytes})
    else:
        print_summary(f"{width} x {height} pixels, {num_bytes:,} bytes -> {command.output}")
