"""docs/design.md tells the truth about rooms and floors, and the list here about who touches files."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

import splatwire

SOURCE = Path(splatwire.__file__).parent
REPOSITORY = Path(__file__).resolve().parents[2]
DESIGN = (REPOSITORY / "docs" / "design.md").read_text(encoding="utf-8")
NOT_ROOMS = {"__init__", "__main__", "version", "assets", "__pycache__", "py"}

READS_AND_WRITES = {"open", "read_bytes", "read_text", "write_bytes", "write_text", "savefig", "safe_open", "save_file",
                    "savez", "savez_compressed", "read_table", "write_table", "ParquetFile", "ZipFile"}  # fmt: skip
"""Names of the calls that move a file's content in or out."""

TOUCH_FILES = """
    channel.trace cli data.photos evaluate.pixels evaluate.study.masks
    evaluate.study.page evaluate.study.pictures evaluate.study.records evaluate.study.references
    evaluate.study.store evaluate.study.toml_file evaluate.study.work files.archive files.capped
    files.kinds files.whole formats.gltf_writer formats._sog_writer formats.compressed_ply
    formats.ply formats.sog formats.splat formats.splatv formats.spz formats.spz_writer model._scene_reader
    model.tensor_file
    packets.stream transport.page_content
"""
"""The modules that may touch files; who adds one says so here."""


def _rows() -> list[tuple[list[str], str]]:
    """Rooms and description of each row of the table of rooms."""
    table = DESIGN.split("## Rooms")[1].split("\n## ")[0]
    rows = [line.split("|")[1:3] for line in table.splitlines() if line.startswith("| `")]
    return [(re.findall(r"`(\w+)`", rooms), words) for rooms, words in rows]


def test_the_table_has_every_room_once():
    there = {path.stem for path in SOURCE.iterdir()} - NOT_ROOMS
    named = [room for rooms, _ in _rows() for room in rooms]
    assert sorted(named) == sorted(there)


def test_the_table_stands_on_the_floors_of_the_contracts():
    """Whoever stands further down in the table may import what stands above, never the other way round."""
    contracts = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = next(c for c in contracts["contracts"] if c["type"] == "layers")["layers"]
    floor = {room.strip(): n for n, layer in enumerate(reversed(layers)) for room in layer.split("|")}
    order = [floor[room] for rooms, _ in _rows() for room in rooms]
    assert order == sorted(order)


def test_the_list_of_those_who_touch_files_is_complete():
    assert _touching_files() == set(TOUCH_FILES.split())


def _touching_files() -> set[str]:
    """Modules that move files' content, by the names of what they call; all of `cli` counts as `cli`."""
    found = set()
    for path in SOURCE.rglob("*.py"):
        words = path.relative_to(SOURCE).with_suffix("").parts
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.Call)
                and _called(node.func) in READS_AND_WRITES
                and not _opens_something_else(node)
            ):
                found.add("cli" if words[0] == "cli" else ".".join(words))
    return found


def _opens_something_else(call: ast.Call) -> bool:
    """`collector.open(manifest, packets)` is no file."""
    method = isinstance(call.func, ast.Attribute) and call.func.attr == "open"
    return method and len(call.args) > 1


def _called(function: ast.expr) -> str:
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


@pytest.mark.parametrize(
    ("noun", "room", "name"),
    [
        ("a lost packet's mask", "channel", "draw_mask"),
        ("damage curves", "plan", "Damage"),
        ("the sketch's fit", "calibrate", "fit_sketch"),
        ("PSNR", "metrics", "psnr"),
    ],
)
def test_a_reader_finds_the_room_of(noun, room, name):
    """The page names the room of a noun, and the code has it there and nowhere else."""
    row = next(line for line in DESIGN.splitlines() if line.startswith("|") and noun in line)
    assert f"`{room}" in row
    homes = {
        path.relative_to(SOURCE).parts[0]
        for path in SOURCE.rglob("*.py")
        if re.search(rf"^(def|class) {name}\b", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert homes == {room}
