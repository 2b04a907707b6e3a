"""Finds and checks all files of an OpenUSD scene before usd-core composes the scene.

A downloaded scene must not read other files of this machine, so only files in its folder are accepted.
"""

import logging
import re
from collections.abc import Callable, Iterator
from glob import escape, glob
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf

from splatwire.errors import DatasetError
from splatwire.io.formats._files import is_in_folder_of

LOG = logging.getLogger(__name__)
MAX_LAYERS = 10_000
"""Maximum number of files that a scene is composed of."""
_CLIPS, _TEMPLATE = "clips", "templateAssetPath"


def checked_layers(path: Path, opening: Callable[[Path], None]) -> tuple[list[Sdf.Layer], list[str]]:
    """Opens the files of an OpenUSD scene, and checks that all of them are in the folder of the scene.

    Args:
        path: Path of the scene.
        opening: Called with each file before usd-core reads it.

    Returns:
        The opened files (layers), and the paths of files that are missing or unreadable. The caller keeps the layers
        until usd-core has composed the scene.

    Raises:
        DatasetError: If a file is outside of the folder of the scene, a file name is a USD expression, there are too
            many files, or usd-core cannot find the scene.
        Tf.ErrorException: If usd-core cannot open the scene.
    """
    opening(path)
    scene = Sdf.Layer.FindOrOpen(str(path))
    if scene is None:
        raise DatasetError(f"{path}: usd-core cannot find it")
    layers, seen, unread = [scene], {scene.identifier}, list[str]()
    for layer in layers:  # grows
        for name, composed in _named_files(layer):
            resolved, exists = _resolved_file(path, layer, name, opening)
            if not exists:
                unread.append(resolved)
            if not composed or not exists or resolved in seen:
                continue
            seen.add(resolved)
            if len(seen) > MAX_LAYERS:
                raise DatasetError(f"{path}: is composed of more than {MAX_LAYERS:,} files")
            try:
                other = Sdf.Layer.FindOrOpen(resolved)
            except Tf.ErrorException:  # such as a format that usd-core does not have
                other = None
            if other is None:
                LOG.warning("%s: names %.200s, which cannot be read: parts of the scene may be missing", path, name)
                unread.append(resolved)
            else:
                layers.append(other)
    return layers, unread


def _named_files(layer: Sdf.Layer) -> Iterator[tuple[str, bool]]:
    """Yields the names of the files that one file (layer) of an OpenUSD scene refers to.

    Yields:
        Name of a file, and a flag: True if the file is a layer, False if it has time samples (value clip).
    """
    for name in sorted(layer.GetCompositionAssetDependencies()):
        if name:  # else a reference within the layer
            yield name, True
    paths: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    for path in paths:
        spec = layer.GetPrimAtPath(path)  # also the prim within a variant
        if spec is not None and spec.HasInfo(_CLIPS):
            for name in _clip_files(layer, spec.GetInfo(_CLIPS)):
                yield name, False


def _clip_files(layer: Sdf.Layer, clips: Any) -> Iterator[str]:
    """Yields the paths of the files with time samples (value clips) of a prim.

    For a template of file names, also yields the path of their folder.

    Args:
        layer: The layer that contains the prim.
        clips: The prim's metadata `clips`, a nested dictionary with the file names.
    """
    for key, value in clips.items():
        if isinstance(value, dict):
            yield from _clip_files(layer, value)
        elif key == _TEMPLATE and value:  # such as ./clip.###.usd; numbers may have more digits
            pattern = Path(layer.ComputeAbsolutePath(str(value)))
            yield str(pattern.parent)
            yield from glob(re.sub("#+", "*", escape(str(pattern))))
        elif isinstance(value, Sdf.AssetPath | Sdf.AssetPathArray):
            names = [value] if isinstance(value, Sdf.AssetPath) else value
            yield from (one.path for one in names if one.path)


def _resolved_file(path: Path, layer: Sdf.Layer, name: str, opening: Callable[[Path], None]) -> tuple[str, bool]:
    """Finds the file that an asset reference of an OpenUSD layer names.

    Logs a warning if the file does not exist.

    Args:
        path: Path of the scene.
        layer: The file (layer) that contains the name.
        name: The name, relative to the layer.
        opening: Called with the file if it exists.

    Returns:
        Identifier of the file in usd-core, and True if the file exists.

    Raises:
        DatasetError: If the file is outside of the folder of the scene, or its name is an expression.
    """
    if name.startswith("`"):
        raise DatasetError(f"{path}: names a file by the expression {name[:80]}, which is not read")
    identifier = layer.ComputeAbsolutePath(name)
    asset = Sdf.Layer.SplitIdentifier(identifier)[0]  # without arguments of the file format
    resolved = str(Ar.GetResolver().Resolve(asset))
    outer = Ar.SplitPackageRelativePathOuter(resolved or asset)[0]
    if not is_in_folder_of(path, path.parent / outer):  # a name without a path is relative if no such file is found
        raise DatasetError(f"{path}: names {name[:200]}, which is outside of its folder: only files in there are read")
    if resolved:
        opening(path.parent / outer)
    else:
        LOG.warning("%s: names %.200s, which does not exist: parts of the scene may be missing", path, name)
    return identifier, bool(resolved)
