"""Properties of scene files and files of explicit Gaussians, for `splatwire inspect`."""

from pathlib import Path
from typing import Any

from splatwire.anchors.appearance import metadata_of, origin_of, scene_of
from splatwire.anchors.tensor_file import tensor_bytes
from splatwire.files.kinds import trained_ply
from splatwire.io import read_any_scene
from splatwire.io.formats import find_format, read_rows_with_origin, splats_kind
from splatwire.types.metadata import SceneMetadata
from splatwire.types.scene_digest import scene_digest
from splatwire.types.splat_statistics import describe_gaussians


def describe_scene(path: Path) -> tuple[dict[str, Any], SceneMetadata]:
    """Returns the properties of a scene file or a file of explicit Gaussians, and the metadata of the scene.

    Raises:
        BitstreamError: If the file is not a scene file.
    """
    if (kind := splats_kind(path)) is not None:
        return _describe_gaussians(path, kind)
    loaded_scene = read_any_scene(path)
    scene = scene_of(loaded_scene.loaded)
    content: dict[str, Any] = {
        "kind": "scene" if loaded_scene.loaded is scene else "partial scene",
        "num_gaussians": scene.num_gaussians,
        "digest": scene_digest(scene.elements),
        "origin": list(origin_of(scene)),
        "num_lost": loaded_scene.num_lost,
        "decoded": loaded_scene.loss_mask is not None,
    }
    form = find_format(loaded_scene.kind)
    size = path.stat().st_size
    parts = {"num_bytes": size, "parts": tensor_bytes(path) if form is None else {form.name: size}}
    return content | parts | dict(scene.facts), metadata_of(scene)


def _describe_gaussians(path: Path, kind: str) -> tuple[dict[str, Any], SceneMetadata]:
    """Describes a file of explicit Gaussians for the output of `inspect`."""
    content, validity = read_rows_with_origin(path)
    splats = content.splats
    kept = splats if validity.all_drawable else splats.select(validity.kept)
    facts = {
        "kind": f"explicit Gaussians ({kind})",
        "num_bytes": _size(path),
        **describe_gaussians(kept, content.origin),
        "origin": list(content.origin),
        "antialiased": content.antialiased,
        "num_rows": splats.num_gaussians,
        "left_out": {
            "draw_nothing": validity.num_invisible,
            "cannot_be_drawn": validity.num_invalid,
            "first_that_cannot": validity.first_invalid,
        },
        "digest": scene_digest(kept),
    }
    return facts, content.metadata


def _size(path: Path) -> int:
    """Returns the size of a file or folder in bytes."""
    # For a model folder of 3DGS, that of the PLY that is read.
    path = (trained_ply(path) if path.is_dir() else None) or path
    return sum(file.stat().st_size for file in path.iterdir()) if path.is_dir() else path.stat().st_size
