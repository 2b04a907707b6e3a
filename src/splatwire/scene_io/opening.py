"""Scenes from files: streams, scene files, explicit Gaussians of any format."""

import os
from dataclasses import dataclass
from pathlib import Path

from splatwire.codec import decode_stream
from splatwire.codec.background import background_of
from splatwire.codec.schemas.gaussians.coding import coding_from_bytes
from splatwire.conceal import Concealer, concealed, create_concealer
from splatwire.errors import BitstreamError
from splatwire.files.kinds import SCENE_FILES, SOG_LEVELS, SPLATS_PLY, STREAMS, Kind, file_kind, is_not
from splatwire.formats import format_of, read_content, read_note
from splatwire.model import SplatCoding, SplatScene
from splatwire.model.appearance import Partial, Scene, scene_of
from splatwire.model.scene_file import load_background, load_scene_file
from splatwire.packets import read_stream
from splatwire.scene import Erasures
from splatwire.scene.background import BLACK, Background
from splatwire.scene.splats import Splats

_WANTED = "a scene file, stream or file of explicit Gaussians"


@dataclass(frozen=True, eq=False)
class SceneFile:
    """What was found in a file.

    Attributes:
        kind: What the file is.
        loaded: The scene, with its gaps if it has some.
        erasures: What of it was received, also where that was concealed since; None for a scene that was never sent.
    """

    kind: Kind
    loaded: Scene | Partial
    erasures: Erasures | None

    @property
    def num_lost(self) -> int:
        """How many of its elements were lost on the way."""
        return 0 if self.erasures is None else self.erasures.num_lost


def open_scene(path: str | os.PathLike[str], conceal: Concealer | str | None = None) -> Scene:
    """Reads a scene of any kind of file; its bytes say which.

    Args:
        path: A stream (`.swz` file or folder), a scene file, or explicit Gaussians: PLY, compressed PLY, SPZ, SOG
            (file or folder), `.splat`, `.ksplat`, `.glb`.
        conceal: What hides the gaps of a scene that lost some of its elements: a concealer or its name. Without one
            a scene with gaps is refused.

    Returns:
        The scene, on the CPU: an `AnchorScene`, or a `SplatScene` of explicit Gaussians.

    Raises:
        DatasetError: If a file of explicit Gaussians is damaged.
        BitstreamError: If the file is none of these, damaged, or has gaps and `conceal` is None.
        UnknownNameError: If there is no such concealer.
    """
    source = Path(path)
    if conceal is not None:
        return drawable_scene(source, conceal)[0]
    kind = file_kind(source)
    if kind in STREAMS:  # told before the work of decoding
        stream, report = read_stream(source)
        stream.still(source)
        if report.num_missing:
            raise _has_gaps(source, report.num_missing, f"stream's {report.num_expected:,} packets")
        scene = decode_stream(stream).scene
        return scene if scene.hints is None else scene.select(~scene.hints.left_out)  # coarser levels stand for others
    found = _read(source, kind)
    scene = scene_of(found.loaded)
    if found.num_lost and found.loaded is not scene:
        raise _has_gaps(source, found.num_lost, f"scene's {scene.num_elements:,} {scene.ELEMENTS}")
    return scene


def has_levels(path: Path) -> bool:
    """Whether a file has coarser Gaussians, too, which are not read: one of a scene that is larger than a view."""
    return file_kind(path) == SOG_LEVELS


def read_scene_file(path: Path) -> SceneFile:
    """Reads a scene with its gaps, and what is known of them; takes the same files as `open_scene`.

    Raises:
        DatasetError: If a file of explicit Gaussians is damaged.
        BitstreamError: If the file is none of these, or damaged.
    """
    return _read(path, file_kind(path))


def drawable_scene(path: Path, concealer: Concealer | str) -> tuple[Scene, int]:
    """Reads a scene and conceals its gaps.

    Returns:
        The scene, and how many of its elements were lost.

    Raises:
        UnknownNameError: If there is no such concealer.
        SplatwireError: See `read_scene_file`.
    """
    method = create_concealer(concealer) if isinstance(concealer, str) else concealer
    found = read_scene_file(path)
    return concealed(found.loaded, method), found.num_lost


def background_of_file(path: Path) -> Background:
    """The background of a scene, of which little more than the header is read.

    Raises:
        BitstreamError: If the file is no scene.
    """
    kind = file_kind(path)
    if format_of(kind) is not None:
        return BLACK
    return background_of(read_stream(path)[0]) if kind in STREAMS else load_background(path)


def _read(path: Path, kind: Kind) -> SceneFile:
    if format_of(kind) is not None:
        content = read_content(path)
        scene = SplatScene(
            content.splats,
            coding=_coding(path, kind, content.splats),
            antialiased=content.antialiased,
            origin=content.origin,
            metadata=content.metadata,
        )
        return SceneFile(kind, scene, None)
    if kind in STREAMS:
        partial = decode_stream(read_stream(path)[0].still(path))
        return SceneFile(kind, partial, partial.erasures)
    if kind in SCENE_FILES:
        return SceneFile(kind, *load_scene_file(path))
    raise BitstreamError(is_not(path, _WANTED))


def _coding(path: Path, kind: Kind, splats: Splats) -> SplatCoding | None:
    """What the Gaussians of a PLY were rounded to, if it says so."""
    note = read_note(path) if kind is SPLATS_PLY else None
    if note is None or len(note.marks) != splats.num_gaussians:
        return None
    return coding_from_bytes(note.content, note.marks, splats.degree)


def _has_gaps(path: Path, lost: int, what: str) -> BitstreamError:
    how = "`splatwire decode --conceal NAME`, or in Python `open_scene(path, conceal=NAME)`"
    return BitstreamError(f"{path}: {lost:,} of the {what} were lost; conceal it first: {how}")
