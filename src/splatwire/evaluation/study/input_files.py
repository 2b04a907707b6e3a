"""Streams, scene files and model folders of an evaluation, which each process reads once."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from splatwire.anchors.appearance import scene_of
from splatwire.bitstream import SceneStream, read_stream
from splatwire.files.kinds import HACPP, file_kind
from splatwire.files.names import real_path
from splatwire.io import LoadedScene, read_any_scene
from splatwire.io.importing import import_model
from splatwire.types import AnchorScene
from splatwire.types.scene import Scene

_STREAMS, _SCENES = 4, 1
"""Maximum number of streams, and of scene files or models, that are kept in memory."""
Key = TypeVar("Key")
Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class InputFiles:
    """Reader of streams, scene files and model folders that keeps the most recently used ones in memory.

    The files must not change.
    """

    _streams: "OrderedDict[Path, SceneStream]" = field(default_factory=OrderedDict, repr=False)
    _scenes: "OrderedDict[Path, LoadedScene]" = field(default_factory=OrderedDict, repr=False)
    _models: "OrderedDict[Path, AnchorScene]" = field(default_factory=OrderedDict, repr=False)

    def stream(self, path: Path) -> SceneStream:
        """Reads a stream."""
        return keep(self._streams, real_path(path), _STREAMS, lambda: read_stream(path)[0])

    def loaded_scene(self, path: Path) -> LoadedScene:
        """Reads a scene file or a file of explicit Gaussians."""
        return keep(self._scenes, real_path(path), _SCENES, lambda: read_any_scene(path))

    def model(self, folder: Path) -> AnchorScene:
        """Reads a model folder of HAC++."""
        return keep(self._models, real_path(folder), _SCENES, lambda: import_model("hacpp", folder))

    def scene(self, path: Path) -> Scene:
        """Reads a scene file, a file of explicit Gaussians or a model folder of HAC++; lost elements stay in it."""
        return self.model(path) if file_kind(path) is HACPP else scene_of(self.loaded_scene(path).loaded)


def keep(cache: "OrderedDict[Key, Value]", key: Key, max_values: int, make: Callable[[], Value]) -> Value:
    """Returns a value of a least-recently-used cache, and computes the value if absent.

    Args:
        cache: The cache; changed in place.
        key: The key.
        max_values: Maximum number of values.
        make: Function that computes the value.
    """
    if key not in cache:
        while len(cache) >= max_values:
            cache.popitem(last=False)
        cache[key] = make()
    cache.move_to_end(key)
    return cache[key]
