"""Implementation of `splatwire inspect`: describes the content of a stream or scene file."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from splatwire.bitstream import ReadReport, SceneStream, is_stream, measure_sizes, read_stream
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.bitstream.sections import sections_of, side_info_parts
from splatwire.bitstream.tile_index import SECTION as TILES
from splatwire.bitstream.tiles import read_tiles
from splatwire.cli._files import input_path, read_report_json
from splatwire.cli._output import print_facts, print_json
from splatwire.cli.inspect import Inspect
from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.metadata import read_metadata
from splatwire.codec.update.section import SECTION as UPDATE
from splatwire.codec.update.section import manifest_digest, read_update
from splatwire.types.metadata import SceneMetadata, metadata_to_json


def run(command: Inspect) -> None:
    """Runs `splatwire inspect`: prints the properties of a file."""
    with input_path(command.source) as path:
        content = describe(path)
    if command.json:
        print_json(content)
    else:
        _print_table(command.source, content)


def describe(path: Path) -> dict[str, Any]:
    """Returns the properties of a stream or scene file as names and values.

    Raises:
        BitstreamError: If the file is neither a stream nor a scene file.
    """
    if is_stream(path):
        return _describe_stream(*read_stream(path))
    from splatwire.cli._inspected_scenes import describe_scene  # its libraries take longer to load than a stream takes

    content, metadata = describe_scene(path)
    return {**content, **_describe_metadata(metadata)}


def _describe_stream(stream: SceneStream, report: ReadReport) -> dict[str, Any]:
    manifest, sizes = stream.manifest, measure_sizes(stream)
    return {
        "kind": "stream",
        **sizes.to_json(),
        "codec": manifest.schema_name,
        "side_info_parts": side_info_parts(stream.side_info, manifest.schema_name),
        "num_packets_expected": manifest.num_packets,
        "num_lost_packets": report.num_missing,
        "packets": read_report_json(report),
        "packetization": asdict(manifest.packetization),
        "stream_id": f"{manifest.stream_id:08x}",
        "symbols_digest": manifest.symbols_digest,
        "manifest_digest": manifest_digest(manifest),
        "format_version": manifest.format_version,
        "writer": manifest.writer,
        **(_describe_sequence(stream) if manifest.schema.timed else {}),
        **_describe_levels(stream),
        **_describe_update(stream),
        **_describe_scene_sections(stream),
        **_describe_metadata(read_metadata(sections_of(stream))),
    }


def _describe_metadata(metadata: SceneMetadata) -> dict[str, Any]:
    """Returns title, author, license and default view of a scene; empty if no metadata is set."""
    stated = metadata_to_json(metadata)
    return {"metadata": stated} if stated else {}


def _describe_sequence(stream: SceneStream) -> dict[str, Any]:
    from splatwire.sequence.description import count_motions, describe_sequence  # decodes, with libraries for that

    complete = len(stream.packets) == stream.manifest.num_packets
    return {"clip": {**describe_sequence(stream), **(count_motions(stream) if complete else {})}}


def _describe_scene_sections(stream: SceneStream) -> dict[str, Any]:
    """Returns the scene properties in the named sections of a stream: origin and antialiasing flag."""
    sections = sections_of(stream)
    return {"origin": list(ORIGIN_SECTION.read(sections)), "antialiased": ANTIALIASED in sections}


def _describe_levels(stream: SceneStream) -> dict[str, Any]:
    """Returns the levels of detail of a stream, the finest first; empty for a stream without levels."""
    if TILES not in sections_of(stream):
        return {}
    tiles, levels = read_tiles(stream.manifest, stream.side_info), {}
    for level in range(int(tiles.levels.max()) + 1):
        of_level = tiles.levels == level
        levels[f"level {level}"] = {
            "tiles": int(of_level.sum()),
            "Gaussians": int(tiles.counts[of_level].sum()),
            "bytes": int(tiles.sizes[of_level].sum()),
            "error": float(tiles.errors[of_level].mean()),
            "largest error": float(tiles.errors[of_level].max()),
        }
    return {"levels": levels}


def _describe_update(stream: SceneStream) -> dict[str, Any]:
    """Describes an update: the streams before and after it, and the size of its list of removed elements in bytes.

    Returns:
        The description; empty if the stream is no update.
    """
    if UPDATE not in (sections := sections_of(stream)):
        return {}
    fields = read_update(sections[UPDATE])
    digests = {"base_digest": fields.base_digest, "result_digest": fields.result_digest}
    return {"update": {**digests, "removed_bytes": len(fields.removed)}}


def _print_table(source: str, content: Mapping[str, Any]) -> None:
    groups: list[list[tuple[str, str]]] = [[]]
    for key, value in content.items():
        if isinstance(value, Mapping):
            groups.append([(f"{key}: {name}", _text(item)) for name, item in value.items() if item not in ([], ())])
            groups.append([])
        elif key == "origin":
            groups[-1].append((key, ", ".join(map(_text, value))))
        elif key != "kind":
            groups[-1].append((key, _text(value)))
    print_facts(groups, f"{source} ({content['kind']})", aligned=True)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:,.3f}" if 0.01 <= abs(value) < 1e9 or value == 0 else f"{value:.3g}"
    if isinstance(value, list) and value and all(isinstance(item, float) for item in value):
        return (" to " if len(value) == 2 else ", ").join(map(_text, value))  # a range, or coordinates
    if isinstance(value, list):
        return "\n".join(map(_text, value)) or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_text(item)}" for key, item in value.items())
    return "-" if value is None else str(value)
