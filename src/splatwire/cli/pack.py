"""`splatwire pack`: a stream and its receiver in one file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._files import input_path, output_path
from splatwire.cli._output import JsonFlag, print_json, print_summary


@dataclass(frozen=True)
class Pack:
    """Write one HTML file that shows a stream in a browser; it needs nothing else, not even a network."""

    source: tyro.conf.Positional[str]
    """Stream of explicit Gaussians or of the causal model: a .swz file or a folder; - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """HTML file to write; - for standard output."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.files.whole import written_whole
        from splatwire.packets import read_stream
        from splatwire.transport.pack import pack_stream

        with input_path(self.source) as path:
            stream, report = read_stream(path)
            data = pack_stream(stream, Path(self.source).stem)
        with output_path(self.output, suffix=".html", json=self.json) as target, written_whole(target) as new:
            new.write_bytes(data)
        if self.json:
            print_json({"bytes": len(data), "num_packets": len(stream.packets), "num_lost_packets": report.num_missing})
        else:
            print_summary(f"{len(stream.packets)} packets, {len(data):,} bytes -> {self.output}", self.output)
