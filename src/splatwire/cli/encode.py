"""`splatwire encode`: a scene file becomes a stream."""

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._files import input_path, output_path
from splatwire.cli._output import JsonFlag, print_json, print_summary, progress_bars

if TYPE_CHECKING:
    from splatwire.packets import Packetization


@dataclass(frozen=True)
class Encode:
    """Encode a scene file into a stream of independently decodable packets."""

    scene: tyro.conf.Positional[str]
    """Scene file; - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Stream to write: one file if it ends in .swz (or is -), a folder of packets otherwise."""
    preset: str = "paper"
    """Packetization to start from."""
    block_size: int | None = None
    """Most anchors of a spatial block."""
    lanes: int | None = None
    """Packets that a block is split into."""
    lane_seed: int | None = None
    """Seed of the lane hash."""
    order: str | None = None
    """Ranking of anchors: morton or raster."""
    grouping: str | None = None
    """Anchors of a lane: stratified (hashed) or contiguous."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        packetization = self.packetization()
        from splatwire.codec import encode_scene
        from splatwire.model.scene_file import load_scene
        from splatwire.packets import write_stream

        with input_path(self.scene) as source:
            scene = load_scene(source)
        started = time.perf_counter()
        with progress_bars() as report, output_path(self.output, suffix=".swz", json=self.json) as path:
            stream = encode_scene(scene, packetization, progress=lambda share: report("encoding", share))
            seconds = time.perf_counter() - started
            write_stream(stream, path)
        if self.json:
            print_json(
                {
                    "output": self.output,
                    "num_bytes": stream.num_bytes,
                    "parts": stream.parts(),
                    "num_packets": len(stream.packets),
                    "num_anchors": stream.manifest.num_anchors,
                    "seconds": seconds,
                }
            )
        else:
            text = f"{stream.manifest.num_anchors:,} anchors in {len(stream.packets):,} packets"
            print_summary(f"{text}, {stream.num_bytes:,} bytes, {seconds:.1f} s -> {self.output}", self.output)

    def packetization(self) -> "Packetization":
        """The preset with what the user changed.

        Raises:
            UnknownNameError: If there is no such preset, order or grouping.
            InvalidValueError: If a number is out of range.
        """
        from splatwire.errors import UnknownNameError
        from splatwire.packets import PRESETS

        if self.preset not in PRESETS:
            raise UnknownNameError("preset", self.preset, PRESETS)
        changes = {
            "block_size": self.block_size,
            "lanes": self.lanes,
            "seed": self.lane_seed,
            "order": self.order,
            "grouping": self.grouping,
        }
        given = {key: value for key, value in changes.items() if value is not None}
        return replace(PRESETS[self.preset], **given)  # type: ignore[arg-type]
