"""Implementation of `splatwire import`: converts a model of other software to a scene file or a PLY file."""

import time
from pathlib import Path

from splatwire.cli._files import output_path, refuse_own_input
from splatwire.cli._output import print_json, print_summary
from splatwire.cli.import_model import Import
from splatwire.errors import InvalidValueError
from splatwire.io import save_scene
from splatwire.io.formats import read_content
from splatwire.io.formats.dispatch import warn_of_background
from splatwire.io.formats.ply import write_ply
from splatwire.io.importing import import_model
from splatwire.io.opening import background_of
from splatwire.types.metadata import metadata_to_json
from splatwire.types.scene_digest import scene_digest


def run(command: Import) -> None:
    """Runs `splatwire import`: converts a model of other software."""
    if command.appearance is not None and command.kind != "scaffold":
        raise InvalidValueError("--appearance is for scaffold models")
    refuse_own_input(command.output, command.model_dir)
    started = time.perf_counter()
    explicit = command.kind == "splats"
    with output_path(command.output, expected_suffix=".ply" if explicit else "", json=command.json) as path:
        result = _explicit(command, path) if explicit else _neural(command, path)
        num_bytes = path.stat().st_size
    if command.json:
        seconds = time.perf_counter() - started
        print_json({"output": command.output, **result, "num_bytes": num_bytes, "seconds": seconds})
    else:
        anchors, gaussians = (result.get(key) for key in ("num_anchors", "num_gaussians"))
        text = f"{anchors:,} anchors" if anchors is not None else f"{gaussians:,} Gaussians"
        print_summary(f"{text}, {num_bytes:,} bytes -> {command.output}", command.output)


def _neural(command: Import, path: Path) -> dict[str, object]:
    options = {} if command.appearance is None else {"appearance": command.appearance}
    scene = import_model(command.kind, command.model_dir, **options)
    save_scene(scene, path)
    return {"num_anchors": scene.anchors.num_anchors, "digest": scene_digest(scene.anchors)}


def _explicit(command: Import, path: Path) -> dict[str, object]:
    content = read_content(command.model_dir)
    splats, antialiased, origin = content.splats, content.antialiased, content.origin
    warn_of_background(Path(command.output), background_of(command.model_dir))
    count = write_ply([splats], path, antialiased=antialiased, origin=origin, metadata=content.metadata)
    return {
        "num_gaussians": count, "degree": splats.degree, "antialiased": antialiased, "origin": list(origin),
        "metadata": metadata_to_json(content.metadata),
    }  # fmt: skip
