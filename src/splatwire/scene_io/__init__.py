"""Scenes from and to files of any kind: one look at a file decides what it is, and every verb goes through here."""

from splatwire.scene_io.opening import (
    SceneFile,
    background_of_file,
    drawable_scene,
    has_levels,
    open_scene,
    read_scene_file,
)
from splatwire.scene_io.saving import save_decoded, save_scene

__all__ = [
    "SceneFile",
    "background_of_file",
    "drawable_scene",
    "has_levels",
    "open_scene",
    "read_scene_file",
    "save_decoded",
    "save_scene",
]
