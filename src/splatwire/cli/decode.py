"""`splatwire decode`: what arrived of a stream becomes a scene file."""

import time
from dataclasses import dataclass
from typing import Annotated

import tyro

from splatwire.cli._files import input_path, output_path, read_report_json
from splatwire.cli._output import JsonFlag, print_json, print_summary, progress_bars


@dataclass(frozen=True)
class Decode:
    """Decode what arrived of a stream; nothing but its bytes is needed."""

    stream: tyro.conf.Positional[str]
    """Stream: a .swz file, a folder, or - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Scene file to write."""
    conceal: str | None = None
    """Concealer that fills what was lost (drop, prior, idw, cari, grow, ...). Without it the gaps stay marked in the
    file, and render or evaluate conceal them."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.codec import decode_stream
        from splatwire.conceal import conceal, create_concealer
        from splatwire.model.scene_digest import scene_digest
        from splatwire.model.scene_file import save_partial, save_scene
        from splatwire.packets import read_stream

        concealer = None if self.conceal is None else create_concealer(self.conceal)
        with input_path(self.stream) as source:
            stream, report = read_stream(source)
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
