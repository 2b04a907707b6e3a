"""Files that an OpenUSD scene is composed of, found and checked before usd-core composes them.

A scene may name further files: sublayers, references, payloads and value clips. Composition opens them wherever they
are. A file from elsewhere must not read others of this machine, so only those in the folder of the scene are accepted.
"""

import logging
import os
from collections.abc import Iterator
from glob import glob, has_magic
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf

from splatwire.errors import DatasetError

LOG = logging.getLogger(__name__)
MAX_LAYERS = 10_000
"""Maximum number of files that a scene is composed of."""
_CLIPS, _TEMPLATE = "clips", "templateAssetPath"


def checked_layers(path: Path) -> list[Sdf.Layer]:
    """Opens all files that a scene is composed of; as long as they are held, usd-core does not read them again.

    A missing file gives a warning.

    Raises:
        DatasetError: If a file is outside of the folder of the scene, is named by an expression, or there are too many.
        Tf.ErrorException: If usd-core cannot open a file.
    """
    folder = os.path.realpath(path.parent)
    layers = [Sdf.Layer.FindOrOpen(str(path))]
    seen = {layers[0].identifier}
    for layer in layers:  # grows
        for name, composed in _named_files(layer):
            found = _resolved_file(path, layer, name, folder)
            if not composed or found is None or found in seen:
                continue
            seen.add(found)
            if len(seen) > MAX_LAYERS:
                raise DatasetError(f"{path}: is composed of more than {MAX_LAYERS:,} files")
            other = Sdf.Layer.FindOrOpen(found)
            if other is not None:
                layers.append(other)
    return layers


def _named_files(layer: Sdf.Layer) -> Iterator[tuple[str, bool]]:
    """Yields each file name in a layer, and True if the file is composed, which may name further ones."""
    for name in sorted(layer.GetCompositionAssetDependencies()):
        if name:  # else a reference within the layer
            yield name, True
    places: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, places.append)
    for place in places:
        spec = layer.GetObjectAtPath(place)
        if isinstance(spec, Sdf.PrimSpec) and spec.HasInfo(_CLIPS):
            for name in _clip_files(layer, spec.GetInfo(_CLIPS)):
                yield name, False


def _clip_files(layer: Sdf.Layer, clips: Any) -> Iterator[str]:
    """Yields the file names in the metadata about value clips (files with time samples) of a prim."""
    for key, value in clips.items():
        if isinstance(value, dict):
            yield from _clip_files(layer, value)
        elif key == _TEMPLATE:  # such as ./clip.###.usd
            pattern = layer.ComputeAbsolutePath(str(value)).replace("#", "?")
            yield from [pattern, *(glob(pattern) if has_magic(pattern) else [])]
        elif isinstance(value, Sdf.AssetPath):
            yield value.path
        elif isinstance(value, Sdf.AssetPathArray):
            yield from (one.path for one in value)


def _resolved_file(path: Path, layer: Sdf.Layer, name: str, folder: str) -> str | None:
    """Returns the identifier of a file that a layer names; None if it does not exist.

    Args:
        path: The scene.
        layer: The layer that names the file.
        name: The file's name in the layer.
        folder: Folder in which the file must be, without links.

    Raises:
        DatasetError: If the file is outside of this folder, or its name is an expression.
    """
    if name.startswith("`"):
        raise DatasetError(f"{path}: names a file by the expression {name[:80]}, which is not read")
    identifier = layer.ComputeAbsolutePath(name)
    resolved = str(Ar.GetResolver().Resolve(identifier))
    outer = Ar.SplitPackageRelativePathOuter(resolved or identifier)[0]
    if os.path.commonpath([folder, os.path.realpath(outer)]) != folder:
        raise DatasetError(f"{path}: names {name[:200]}, which is outside of its folder: only files in there are read")
    if not resolved and not has_magic(name):
        LOG.warning("%s: names %.200s, which does not exist: parts of the scene may be missing", path, name)
    return identifier if resolved else None
