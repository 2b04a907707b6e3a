"""Scenes from and to files: streams, scene files, explicit Gaussians of any format."""

from pathlib import Path

from splatwire.codec import decode_stream
from splatwire.codec.background import background_of
from splatwire.conceal import Concealer, conceal, concealed
from splatwire.errors import BitstreamError
from splatwire.formats import read_splats, splats_kind, write_splats
from splatwire.model import PartialScene, SplatScene
from splatwire.model.appearance import Partial, Scene
from splatwire.model.scene_file import load_background, load_scene, load_scene_file, save_partial, save_scene
from splatwire.packets import is_stream, read_stream
from splatwire.scene import Erasures
from splatwire.scene.background import BLACK, Background


def open_scene(path: Path) -> tuple[Scene | Partial, Erasures | None]:
    """Reads a scene, with its gaps if it has some.

    Args:
        path: A stream (file or folder), a scene file of either kind, or explicit Gaussians.

    Returns:
        The scene, and what of it was received; None for a scene that was never sent.

    Raises:
        DatasetError: If a file of explicit Gaussians is damaged.
        BitstreamError: If the file is none of these, or damaged.
    """
    if splats_kind(path) is not None:
        return SplatScene(read_splats(path)), None
    if is_stream(path):
        partial = decode_stream(read_stream(path)[0])
        return partial, partial.erasures
    return load_scene_file(path)


def drawable_scene(path: Path, concealer: Concealer | str) -> tuple[Scene, int]:
    """Reads a scene and conceals its gaps.

    Returns:
        The scene, and how many of its elements were lost.

    Raises:
        UnknownNameError: If there is no such concealer.
        SplatwireError: See `open_scene`.
    """
    loaded, erasures = open_scene(path)
    return concealed(loaded, concealer), 0 if erasures is None else erasures.num_lost


def complete_scene(path: Path) -> Scene:
    """Reads a scene of which nothing is missing.

    Raises:
        BitstreamError: If it has gaps.
        SplatwireError: See `open_scene`.
    """
    if is_stream(path):
        stream, _ = read_stream(path)
        if len(stream.packets) != stream.manifest.num_packets:
            raise BitstreamError(f"{path} has lost packets: encoding it again needs a complete stream")
        return decode_stream(stream).scene
    return SplatScene(read_splats(path)) if splats_kind(path) is not None else load_scene(path)


def background_of_file(path: Path) -> Background:
    """The background of a scene, of which little more than the header is read.

    Raises:
        BitstreamError: If the file is no scene.
    """
    if splats_kind(path) is not None:
        return BLACK
    return background_of(read_stream(path)[0]) if is_stream(path) else load_background(path)


def save_decoded(partial: Partial, concealer: Concealer | None, path: Path) -> Scene:
    """Writes what a decoder returned.

    Args:
        partial: Anchors, which become a scene file, or explicit Gaussians, in the format that the name says.
        concealer: What hides the gaps; None keeps those of anchors in the file, and leaves lost Gaussians out.
        path: Where to.

    Returns:
        The scene in the file; of Gaussians, with those that were left out.

    Raises:
        UnknownNameError: If the name says no format of explicit Gaussians.
        InvalidValueError: If the concealer is not for these elements.
        OSError: If the file cannot be written.
    """
    if concealer is None and isinstance(partial, PartialScene):
        save_partial(partial, path)
        return partial.scene
    scene = conceal(partial, concealer or "drop")
    if isinstance(scene, SplatScene):
        write_splats([scene.drawn()], path)
    else:
        save_scene(scene, path, erasures=partial.erasures)
    return scene
