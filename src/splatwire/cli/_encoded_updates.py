"""Implementation of `splatwire encode --update`: encodes only the changes of a scene since an earlier stream."""

import time
from typing import Any

from splatwire.bitstream import read_stream, write_stream
from splatwire.cli._files import STANDARD, input_path, output_path
from splatwire.cli._output import print_json, print_summary, progress_bars
from splatwire.cli.encode import Encode
from splatwire.codec import encode_update
from splatwire.codec.update.apply import check_base, describe_update
from splatwire.errors import InvalidValueError
from splatwire.render.precision import scene_class_offsets
from splatwire.types import Cameras


def encode_update_of(command: Encode, scene: Any, cameras: Cameras | None) -> None:
    """Runs `splatwire encode --update`: writes a stream with the changes of a scene relative to an existing stream.

    Prints the numbers of kept, removed and new Gaussians, and the size of the written stream.

    Args:
        command: Options of the command: `update` is the existing stream, `output` the file to write.
        scene: The changed scene.
        cameras: Cameras of the images in which the precision of the Gaussians is measured; None to generate cameras.
    """
    assert command.update is not None
    if command.scene == command.update == STANDARD:
        raise InvalidValueError("the scene and the stream to update cannot both be standard input")
    with input_path(command.update) as path:
        base = read_stream(path)[0]
    check_base(base)  # before the precision of the scene is measured
    with progress_bars() as report, output_path(command.output, expected_suffix=".swz", json=command.json) as path:
        started = time.perf_counter()
        report("choosing precision", 0.0)
        classes = scene_class_offsets(scene, cameras, recompute=True)
        report("choosing precision", 1.0)
        report("encoding", 0.0)
        stream = encode_update(base, scene, class_offsets=classes)
        report("encoding", 1.0)
        seconds = time.perf_counter() - started
        write_stream(stream, path)
    facts, share = describe_update(base, stream), stream.num_bytes / base.num_bytes
    if command.json:
        counts = {"num_bytes": stream.num_bytes, "share": share, **facts}
        print_json({"output": command.output, **counts, "seconds": seconds})
        return
    text = f"{facts['num_kept']:,} Gaussians stay, {facts['num_removed']:,} are removed, {facts['num_new']:,} are new"
    text = f"{text}, {stream.num_bytes:,} bytes ({share:.1%} of {command.update}), {seconds:.1f} s"
    print_summary(f"{text} -> {command.output}", command.output)
