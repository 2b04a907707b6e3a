"""`splatwire pack`: a stream and its receiver in one file."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._files import input_path, output_path, stream_name
from splatwire.cli._output import JsonFlag, print_json, print_summary
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.scene.splats import Splats

FALLBACK = 4096
"""How many Gaussians stand in for a stream where it cannot be read, without harmonics: 246 kB."""


@dataclass(frozen=True)
class Pack:
    """Write one HTML file that shows streams in a browser; it needs nothing else, not even a network.

    With a name that ends in .glb: one glTF file with the stream of explicit Gaussians, and a few thousand Gaussians for
    programs that cannot read streams (the draft EXT_splatwire).
    """

    sources: tyro.conf.Positional[tuple[str, ...]]
    """Streams of explicit Gaussians or of the causal model: .swz files or folders; - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """HTML or glTF file to write; - for HTML on standard output."""
    accept_damage: bool = False
    """Exit with status 0 although bytes of the stream are damaged; packets that are only missing need no option."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.files.whole import written_whole
        from splatwire.packets import SceneStream, read_stream, stream_to_bytes
        from splatwire.transport.pack import pack_streams

        gltf = self.output.lower().endswith(".glb")
        if not self.sources or (gltf and len(self.sources) > 1):
            raise InvalidValueError("a glTF file takes one stream" if self.sources else "name a stream to pack")
        streams, num_lost = dict[str, SceneStream](), 0
        for source in self.sources:
            name = stream_name(source)
            if name in streams:
                raise InvalidValueError(f"two streams are called {name}")
            with input_path(source) as path:
                streams[name], report = read_stream(path)
                num_lost += report.num_missing
                if gltf:
                    streams[name].still(path)
                    fallback = _fallback(path)
        num_packets = sum(len(stream.packets) for stream in streams.values())
        data = b"" if gltf else pack_streams(streams)
        with output_path(self.output, suffix=".glb" if gltf else ".html", json=self.json) as target:
            if gltf:
                from splatwire.codec.antialiasing import SECTION as ANTIALIASED
                from splatwire.codec.origin import origin_of_stream
                from splatwire.formats import write_gltf_with_stream
                from splatwire.packets.sections import sections_of

                [stream] = streams.values()
                origin, antialiased = origin_of_stream(stream), ANTIALIASED in sections_of(stream)
                write_gltf_with_stream(
                    stream_to_bytes(stream), fallback, target, antialiased=antialiased, origin=origin
                )
            else:
                with written_whole(target) as new:
                    new.write_bytes(data)
            num_bytes = target.stat().st_size
        if self.json:
            print_json({"bytes": num_bytes, "num_packets": num_packets, "num_lost_packets": num_lost})
        else:
            print_summary(f"{num_packets} packets, {num_bytes:,} bytes -> {self.output}", self.output)


def _fallback(path: Path) -> "Splats":
    """Few Gaussians that stand for those of a stream, its losses concealed."""
    from splatwire.levels.merging import reduced
    from splatwire.model.appearance import explicit_gaussians
    from splatwire.scene_io import open_scene

    splats = explicit_gaussians(open_scene(path, "grow"))
    if splats is None:
        raise InvalidValueError(f"{path}: its Gaussians depend on the view, and those of a glTF file do not")
    plain = splats.at_most_degree(0)
    return plain if plain.num_gaussians <= FALLBACK else reduced(plain, FALLBACK)[0]
