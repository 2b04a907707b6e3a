"""`splatwire inspect`: what is in a stream or a scene file."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from splatwire.cli._files import input_path, is_stream, read_report_json
from splatwire.cli._output import JsonFlag, print_json
from splatwire.cli._terminal import print_table
from splatwire.files.kinds import trained_ply

if TYPE_CHECKING:
    from splatwire.packets import ReadReport, SceneStream
    from splatwire.scene.metadata import SceneMetadata


@dataclass(frozen=True)
class Inspect:
    """Show what is in a stream, scene file or file of Gaussians: bytes by part, losses; bounds, sizes, problems."""

    source: tyro.conf.Positional[str]
    """Stream (a .swz file or a folder), scene file or explicit Gaussians; - for standard input."""
    accept_damage: bool = False
    """Exit with status 0 although bytes of the stream are damaged; packets that are only missing need no option."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        with input_path(self.source) as path:
            content = describe(path)
        if self.json:
            print_json(content)
        else:
            _print_table(self.source, content)


def describe(path: Path) -> dict[str, Any]:
    """Collects the facts about a stream or a scene file.

    Raises:
        BitstreamError: If it is neither.
    """
    if not is_stream(path):
        return _describe_scene(path)
    from splatwire.packets import read_stream

    return _describe_stream(*read_stream(path))


def _describe_stream(stream: "SceneStream", report: "ReadReport") -> dict[str, Any]:
    from splatwire.codec import side_info_parts
    from splatwire.codec.metadata import read_metadata
    from splatwire.packets import measure_sizes
    from splatwire.packets.sections import sections_of

    manifest, sizes = stream.manifest, measure_sizes(stream)
    return {
        "kind": "stream",
        **sizes.to_json(),
        "codec": manifest.codec,
        "side_info_parts": side_info_parts(stream.side_info, manifest.codec),
        "num_packets_expected": manifest.num_packets,
        "num_lost_packets": report.num_missing,
        "packets": read_report_json(report),
        "packetization": asdict(manifest.packetization),
        "stream_id": f"{manifest.stream_id:08x}",
        "symbols_digest": manifest.symbols_digest,
        "format_version": manifest.format_version,
        "writer": manifest.writer,
        **(_describe_clip(stream) if manifest.schema.timed else {}),
        **_describe_levels(stream),
        **_describe_scene_sections(stream),
        **_describe_metadata(read_metadata(sections_of(stream))),
    }


def _describe_metadata(metadata: "SceneMetadata") -> dict[str, Any]:
    """Title, author, license and view of a scene; nothing where none is known."""
    from splatwire.scene.metadata import metadata_to_json

    known = metadata_to_json(metadata)
    return {"metadata": known} if known else {}


def _describe_clip(stream: "SceneStream") -> dict[str, Any]:
    from splatwire.cli._clips import count_motions, describe_clip

    complete = len(stream.packets) == stream.manifest.num_packets
    return {"clip": {**describe_clip(stream), **(count_motions(stream) if complete else {})}}


def _describe_scene_sections(stream: "SceneStream") -> dict[str, Any]:
    """Origin and antialiasing of a stream's scene."""
    from splatwire.codec.antialiasing import SECTION
    from splatwire.codec.origin import read_origin
    from splatwire.packets.sections import sections_of

    sections = sections_of(stream)
    return {"origin": list(read_origin(sections)), "antialiased": SECTION in sections}


def _describe_levels(stream: "SceneStream") -> dict[str, Any]:
    """Levels of a scene that is larger than a view, the finest first; nothing where there are none."""
    from splatwire.packets.sections import sections_of
    from splatwire.packets.tile_index import SECTION

    if SECTION not in sections_of(stream):
        return {}
    from splatwire.levels import tiles_of

    tiles, levels = tiles_of(stream), {}
    for level in range(int(tiles.levels.max()) + 1):
        here = tiles.levels == level
        levels[f"level {level}"] = {
            "tiles": int(here.sum()),
            "Gaussians": int(tiles.counts[here].sum()),
            "bytes": int(tiles.sizes[here].sum()),
            "error": float(tiles.errors[here].mean()),
            "largest error": float(tiles.errors[here].max()),
        }
    return {"levels": levels}


def _describe_scene(path: Path) -> dict[str, Any]:
    from splatwire.formats import splats_kind
    from splatwire.model.appearance import metadata_of, scene_of
    from splatwire.model.scene_digest import scene_digest
    from splatwire.model.tensor_file import tensor_bytes
    from splatwire.scene_io import read_scene_file

    if (kind := splats_kind(path)) is not None:
        return _describe_gaussians(path, kind)
    found = read_scene_file(path)
    scene = scene_of(found.loaded)
    content: dict[str, Any] = {
        "kind": "scene" if found.loaded is scene else "partial scene",
        "num_gaussians": scene.num_gaussians,
        "digest": scene_digest(scene.elements),
        "num_lost": found.num_lost,
        "decoded": found.erasures is not None,
    }
    parts = {"num_bytes": path.stat().st_size, "parts": tensor_bytes(path)}
    return content | parts | {**scene.facts, **_describe_metadata(metadata_of(scene))}


def _describe_gaussians(path: Path, kind: str) -> dict[str, Any]:
    """A file of explicit Gaussians, with what of its rows is left out where it is drawn or encoded."""
    from splatwire.cli._gaussians import describe_gaussians
    from splatwire.formats import read_all_rows
    from splatwire.model.scene_digest import scene_digest

    content, rows = read_all_rows(path)
    splats = content.splats
    kept = splats if rows.complete else splats.select(rows.kept)
    return {
        "kind": f"explicit Gaussians ({kind})",
        "num_bytes": _size(path),
        **describe_gaussians(kept, content.origin),
        "origin": list(content.origin),
        "antialiased": content.antialiased,
        "num_rows": splats.num_gaussians,
        "left_out": {
            "draw_nothing": rows.num_invisible,
            "cannot_be_drawn": rows.num_invalid,
            "first_that_cannot": rows.first_invalid,
        },
        "digest": scene_digest(kept),
        **_describe_metadata(content.metadata),
    }


def _size(path: Path) -> int:
    """Bytes of a file, or of all files in a folder; of a model folder of 3DGS, those of the PLY that is read."""
    path = (trained_ply(path) if path.is_dir() else None) or path
    return sum(file.stat().st_size for file in path.iterdir()) if path.is_dir() else path.stat().st_size


def _print_table(source: str, content: Mapping[str, Any]) -> None:
    from rich.table import Table

    table = Table(title=f"{source} ({content['kind']})", show_header=False, title_justify="left")
    table.add_column(style="bold")
    table.add_column(justify="right")
    for key, value in content.items():
        if isinstance(value, Mapping):
            table.add_section()
            for name, item in value.items():
                if item not in ([], ()):
                    table.add_row(f"{key}: {name}", _text(item))
            table.add_section()
        elif key == "origin":
            table.add_row(key, ", ".join(map(_text, value)))
        elif key != "kind":
            table.add_row(key, _text(value))
    print_table(table)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:,.3f}" if 0.01 <= abs(value) < 1e9 or value == 0 else f"{value:.3g}"
    if isinstance(value, list) and value and all(isinstance(item, float) for item in value):
        return " to ".join(map(_text, value))
    if isinstance(value, list):
        return "\n".join(map(_text, value)) or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_text(item)}" for key, item in value.items())
    return "-" if value is None else str(value)
