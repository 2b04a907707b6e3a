"""Scenes ready to be drawn, from whatever file the user has."""

from pathlib import Path
from typing import TYPE_CHECKING

from splatwire.cli._files import is_stream

if TYPE_CHECKING:
    from splatwire.model import AnchorScene
    from splatwire.scene.splats import Splats


def load_picturable(path: Path, concealer: str) -> "tuple[AnchorScene | Splats, int]":
    """Reads whatever can be drawn: what `load_drawable` reads, or explicit Gaussians (3DGS PLY, `.splat`).

    Raises:
        UnknownNameError: If there is no such concealer.
        DatasetError: If a file of explicit Gaussians is damaged.
        BitstreamError: If the file is none of these.
    """
    from splatwire.importers.splats import import_splats, splats_kind

    return load_drawable(path, concealer) if splats_kind(path) is None else (import_splats(path), 0)


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
