"""`splatwire decode`: what arrived of a stream becomes a scene file."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._files import input_path, output_path, read_report_json
from splatwire.cli._output import JsonFlag, print_json, print_summary, progress_bars

if TYPE_CHECKING:
    from splatwire.packets import ReadReport, SceneStream


@dataclass(frozen=True)
class Decode:
    """Decode what arrived of a stream; nothing but its bytes is needed."""

    stream: tyro.conf.Positional[str]
    """Stream: a .swz file, a folder, or - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Scene file to write; for explicit Gaussians a .ply, .spz, .sog or .splat file."""
    conceal: str | None = None
    """Concealer that fills what was lost (drop, prior, idw, cari, grow, ...). Without it the gaps stay marked in the
    file, and render or evaluate conceal them; explicit Gaussians that were lost are left out."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.codec import decode_stream
        from splatwire.conceal import conceal, create_concealer
        from splatwire.model.scene_digest import scene_digest
        from splatwire.model.scene_file import save_partial, save_scene
        from splatwire.packets import GAUSSIANS, read_stream

        concealer = None if self.conceal is None else create_concealer(self.conceal)
        with input_path(self.stream) as source:
            stream, report = read_stream(source)
        if stream.manifest.codec == GAUSSIANS:
            self._decode_splats(stream, report)
            return
        started = time.perf_counter()
        with progress_bars() as show, output_path(self.output, json=self.json) as path:
            partial = decode_stream(stream, progress=lambda share: show("decoding", share))
            anchors, decoded = partial.scene.anchors, time.perf_counter()
            if concealer is None:
                save_partial(partial, path)
            else:
                scene = conceal(partial, concealer)
                anchors = scene.anchors
                save_scene(scene, path, erasures=partial.erasures)
        num_lost = partial.erasures.num_lost
        if self.json:
            print_json(
                {
                    "output": self.output,
                    "num_anchors": anchors.num_anchors,
                    "num_lost": num_lost,
                    "digest": scene_digest(anchors),
                    "concealer": self.conceal,
                    "seconds": decoded - started,
                    "packets": read_report_json(report),
                }
            )
        else:
            text = f"{anchors.num_anchors - num_lost:,} of {anchors.num_anchors:,} anchors arrived"
            print_summary(f"{text}, decoded in {decoded - started:.1f} s -> {self.output}", self.output)

    def _decode_splats(self, stream: "SceneStream", report: "ReadReport") -> None:
        """Explicit Gaussians, what was lost left out, into a file of whatever format the name says."""
        from splatwire.codec.explicit import decode_explicit
        from splatwire.conceal import conceal_splats
        from splatwire.formats import write_splats

        started = time.perf_counter()
        with progress_bars() as show, output_path(self.output, suffix=Path(self.output).suffix, json=self.json) as path:
            partial = decode_explicit(stream, progress=lambda share: show("decoding", share))
            decoded = time.perf_counter()
            drawn = conceal_splats(partial, self.conceal or "drop").drawn()
            write_splats([drawn], path)
        count, lost = partial.scene.splats.num_gaussians, partial.erasures.num_lost
        if self.json:
            print_json(
                {
                    "output": self.output, "num_gaussians": count, "num_lost": lost, "concealer": self.conceal,
                    "seconds": decoded - started, "packets": read_report_json(report),
                }
            )  # fmt: skip
        else:
            text = f"{count - lost:,} of {count:,} Gaussians arrived"
            print_summary(f"{text}, decoded in {decoded - started:.1f} s -> {self.output}", self.output)
