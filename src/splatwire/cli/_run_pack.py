"""Implementation of `splatwire pack`: writes a stream and a viewer for it into one file."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from splatwire.bitstream import SceneStream, read_stream
from splatwire.cli._files import input_path, output_path, refuse_own_input, stream_name
from splatwire.cli._output import print_json, print_summary
from splatwire.cli.pack import Pack
from splatwire.errors import InvalidValueError
from splatwire.files.atomic_write import atomic_output
from splatwire.transport.http.pack import pack_streams


def run(command: Pack) -> None:
    """Runs `splatwire pack`: writes one HTML or glTF file with streams."""
    gltf = command.output.lower().endswith(".glb")
    if not command.sources or (gltf and len(command.sources) > 1):
        raise InvalidValueError("a glTF file takes one stream" if command.sources else "name a stream to pack")
    refuse_own_input(command.output, *command.sources)
    streams, num_lost = dict[str, SceneStream](), 0
    for source in command.sources:
        name = stream_name(source)
        if name in streams:
            raise InvalidValueError(f"two streams are called {name}")
        with input_path(source) as path:
            stream, report = read_stream(path)
            streams[name] = stream.require_scene(path)
            num_lost += report.num_missing
            write = _gltf_writer(streams[name], path) if gltf else None
    num_packets = sum(len(stream.packets) for stream in streams.values())
    write = write or _page_writer(streams)
    with output_path(command.output, expected_suffix=".glb" if gltf else ".html", json=command.json) as target:
        write(target)
        num_bytes = target.stat().st_size
    if command.json:
        print_json({"bytes": num_bytes, "num_packets": num_packets, "num_lost_packets": num_lost})
    else:
        print_summary(f"{num_packets} packets, {num_bytes:,} bytes -> {command.output}", command.output)


def _page_writer(streams: dict[str, SceneStream]) -> Callable[[Path], None]:
    data = pack_streams(streams)

    def write(target: Path) -> None:
        with atomic_output(target) as new:
            new.write_bytes(data)

    return write


def _gltf_writer(stream: SceneStream, path: Path) -> Callable[[Path], None]:
    stream.require_static(path)
    from splatwire.lod.packed_gltf import fallback_of, write_packed_gltf  # decodes, with libraries that a relay lacks

    return partial(write_packed_gltf, stream, fallback_of(path))
