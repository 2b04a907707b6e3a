"""Scenes ready to be drawn, from whatever file the user has."""

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from splatwire.cli._files import is_stream

if TYPE_CHECKING:
    from splatwire.model import AnchorScene
    from splatwire.scene.background import Background
    from splatwire.scene.splats import Splats

BackgroundOption: TypeAlias = tuple[float, float, float] | None
"""What `--background` takes; None for the scene's own."""


def chosen_background(option: BackgroundOption) -> "Background | None":
    """Checks what the user said; None for nothing.

    Raises:
        InvalidValueError: If it is no colour.
    """
    from splatwire.scene.background import check_background

    return None if option is None else check_background(option)


def background_of_file(path: Path) -> "Background":
    """The background of a stream or scene file, of which little more than the header is read.

    Raises:
        BitstreamError: If the file is neither.
    """
    if is_stream(path):
        from splatwire.codec.background import background_of
        from splatwire.packets import read_stream

        return background_of(read_stream(path)[0])
    from splatwire.model.scene_file import load_background

    return load_background(path)


def load_picturable(path: Path, concealer: str) -> "tuple[AnchorScene | Splats, int]":
    """Reads whatever can be drawn: what `load_drawable` reads, or explicit Gaussians of any format.

    Raises:
        UnknownNameError: If there is no such concealer.
        DatasetError: If a file of explicit Gaussians is damaged.
        BitstreamError: If the file is none of these.
    """
    from splatwire.formats import read_splats, splats_kind

    return load_drawable(path, concealer) if splats_kind(path) is None else (read_splats(path), 0)


def load_drawable(path: Path, concealer: str) -> "tuple[AnchorScene, int]":
    """Reads a scene file, a partial scene file or a stream; gaps are concealed.

    Args:
        path: The file (or the folder of a stream).
        concealer: Name of the concealer for gaps.

    Returns:
        The scene, and how many anchors were lost.

    Raises:
        UnknownNameError: If there is no such concealer.
        BitstreamError: If the file is none of the three.
    """
    from splatwire.conceal import conceal, create_concealer
    from splatwire.model import PartialScene
    from splatwire.model.scene_file import load_scene_file

    method = create_concealer(concealer)
    if is_stream(path):
        from splatwire.codec import decode_stream
        from splatwire.packets import read_stream

        partial = decode_stream(read_stream(path)[0])
        return conceal(partial, method), partial.erasures.num_lost
    loaded, erasures = load_scene_file(path)
    num_lost = 0 if erasures is None else erasures.num_lost
    return (conceal(loaded, method) if isinstance(loaded, PartialScene) else loaded), num_lost
