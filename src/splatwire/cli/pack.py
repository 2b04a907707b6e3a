"""`splatwire pack`: a stream and its receiver in one file."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._files import input_path, output_path
from splatwire.cli._output import JsonFlag, print_json, print_summary

if TYPE_CHECKING:
    from splatwire.scene.splats import Splats

FALLBACK = 4096
"""How many Gaussians stand in for a stream where it cannot be read, without harmonics: 246 kB."""


@dataclass(frozen=True)
class Pack:
    """Write one HTML file that shows a stream in a browser; it needs nothing else, not even a network.

    With a name that ends in .glb: one glTF file with the stream of explicit Gaussians, and a few thousand Gaussians for
    programs that cannot read streams (the draft EXT_splatwire).
    """

    source: tyro.conf.Positional[str]
    """Stream of explicit Gaussians or of the causal model: a .swz file or a folder; - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """HTML or glTF file to write; - for HTML on standard output."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.files.whole import written_whole
        from splatwire.packets import read_stream, stream_to_bytes
        from splatwire.transport.pack import pack_stream

        gltf = self.output.lower().endswith(".glb")
        with input_path(self.source) as path:
            stream, report = read_stream(path)
            if gltf:
                stream.still(path)
                fallback = _fallback(path)
            else:
                data = pack_stream(stream, Path(self.source).stem)
        with output_path(self.output, suffix=".glb" if gltf else ".html", json=self.json) as target:
            if gltf:
                from splatwire.formats import write_gltf_with_stream

                write_gltf_with_stream(stream_to_bytes(stream), fallback, target)
            else:
                with written_whole(target) as new:
                    new.write_bytes(data)
            num_bytes = target.stat().st_size
        if self.json:
            print_json({"bytes": num_bytes, "num_packets": len(stream.packets), "num_lost_packets": report.num_missing})
        else:
            print_summary(f"{len(stream.packets)} packets, {num_bytes:,} bytes -> {self.output}", self.output)


def _fallback(path: Path) -> "Splats":
    """Few Gaussians that stand for those of a stream, its losses concealed."""
    from splatwire.errors import InvalidValueError
    from splatwire.levels.merging import reduced
    from splatwire.model.appearance import explicit_gaussians
    from splatwire.scene_io import open_scene

    splats = explicit_gaussians(open_scene(path, "grow"))
    if splats is None:
        raise InvalidValueError(f"{path}: its Gaussians depend on the view, and those of a glTF file do not")
    plain = splats.at_most_degree(0)
    return plain if plain.num_gaussians <= FALLBACK else reduced(plain, FALLBACK)[0]
