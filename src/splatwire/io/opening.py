"""Reading of scenes from streams, scene files and files of explicit Gaussians."""

import logging
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatwire.anchors.appearance import as_scene, scene_of
from splatwire.anchors.scene_file import load_scene_file
from splatwire.arguments import CheckedFields, checked
from splatwire.bitstream import SceneStream, read_stream
from splatwire.codec import decode_stream
from splatwire.codec.gaussians.coding import coding_from_bytes
from splatwire.concealment import Concealer, conceal_if_received, create_concealer
from splatwire.errors import BitstreamError, DatasetError, InvalidValueError
from splatwire.files.kinds import (
    HACPP,
    MODEL_3DGS,
    SCENE_FILES,
    SPLATS_PLY,
    STREAMS,
    Kind,
    file_kind,
    format_error,
    model_nearby,
    opened,
    trained_ply,
)
from splatwire.files.names import path_of
from splatwire.files.scene_formats import FORMATS
from splatwire.io.formats import find_format, read_content, read_ply_steps
from splatwire.io.formats.dispatch import read_with
from splatwire.io.model_arguments import load_background, model_folder_of
from splatwire.types import LossMask, SplatCoding, SplatScene
from splatwire.types.background import BLACK, Background
from splatwire.types.received_scene import ReceivedScene
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
_EXPECTED = "a scene file, stream or file of explicit Gaussians"


@dataclass(frozen=True, eq=False)
class LoadedScene(CheckedFields):
    """Scene read from a file, with its loss information.

    Attributes:
        kind: Format of the file.
        loaded: The scene; for a stream, or a decoded scene with gaps, a `ReceivedScene`, even if nothing was lost.
        loss_mask: Mask of the elements that were lost in transmission, even if concealed later; None for a scene that
            was not sent.
    """

    kind: Kind
    loaded: Scene | ReceivedScene
    loss_mask: LossMask | None

    @property
    def num_lost(self) -> int:
        """Number of elements lost in transmission."""
        return 0 if self.loss_mask is None else self.loss_mask.num_lost


@checked
def open_scene(path: str | os.PathLike[str], conceal: Concealer | str | None = None) -> Scene:
    """Reads a scene from a file of any supported format, detected by its content.

    Args:
        path: A stream (`.swz` file or folder), a scene file of anchors, or explicit Gaussians: PLY, compressed PLY,
            SPZ, SOG (file or folder), `.splat`, `.ksplat`, glTF, OpenUSD, the model folder of 3DGS, or a format of
            another package.
        conceal: Concealer, or its name, for a scene with losses; None to reject such scenes.

    Returns:
        The scene, on the CPU: an `AnchorScene`, or a `SplatScene` of explicit Gaussians.

    Raises:
        InvalidValueError: If `path` is not a path.
        DatasetError: If a file of explicit Gaussians is damaged.
        BitstreamError: If the file has another format, is damaged, or has losses and `conceal` is None.
        UnknownNameError: If the concealer does not exist.
    """
    with opened(path_of(path, "a scene")) as source:
        if conceal is not None:
            return drawable_scene(source, conceal)[0]
        if file_kind(source) in STREAMS:
            return decode_complete(read_stream(source)[0], source)
        return complete_scene(_read(source), source)


def decode_complete(stream: SceneStream, source: Path) -> Scene:
    """Decodes a complete stream of a static scene, without its coarser levels of detail.

    Args:
        stream: The stream.
        source: Path of the stream, for messages.

    Raises:
        InvalidValueError: If the stream is a sequence.
        BitstreamError: If packets are missing, or the stream is damaged.
    """
    if num_missing := stream.require_static(source).manifest.num_packets - len(stream.packets):
        raise _gaps_error(source, num_missing, f"stream's {stream.manifest.num_packets:,} packets")
    scene: Scene = decode_stream(stream).scene
    return scene if scene.hints is None else scene.select(~scene.hints.left_out)


def complete_scene(loaded_scene: LoadedScene, source: Path) -> Scene:
    """Returns the scene of a file; rejects a scene whose losses are not concealed.

    Args:
        loaded_scene: The content of the file.
        source: Path of the file, for messages.

    Raises:
        BitstreamError: If parts were lost and not concealed.
    """
    scene = scene_of(loaded_scene.loaded)
    if loaded_scene.num_lost and loaded_scene.loaded is not scene:
        raise _gaps_error(source, loaded_scene.num_lost, f"scene's {scene.num_elements:,} {scene.ELEMENTS}")
    return scene


@checked
def read_any_scene(path: Path) -> LoadedScene:
    """Reads a scene and, if packets were lost, the loss mask; accepts the same files as `open_scene`.

    Raises:
        DatasetError: If a file of explicit Gaussians is damaged.
        BitstreamError: If the file has another format, or is damaged.
    """
    with opened(path_of(path, "a scene")) as source:
        return _read(source)


@checked
def drawable_scene(path: Path, concealer: Concealer | str) -> tuple[Scene, int]:
    """Reads a scene for drawing, and conceals its losses.

    Returns:
        The scene, and the number of lost elements.

    Raises:
        UnknownNameError: If the concealer does not exist.
        SplatwireError: See `read_any_scene`.
    """
    method = create_concealer(concealer) if isinstance(concealer, str) else concealer
    loaded_scene = read_any_scene(path)
    return conceal_if_received(loaded_scene.loaded, method), loaded_scene.num_lost


def check_scene_kind(path: Path) -> None:
    """Checks that a file or folder is of a format that `read_any_scene` reads. Only its beginning is read.

    Raises:
        BitstreamError: If it has another format.
    """
    kind = file_kind(path)
    if find_format(kind) is None and kind not in STREAMS and kind not in SCENE_FILES:
        raise BitstreamError(format_error(path, _EXPECTED) + model_nearby(path, MODEL_3DGS, HACPP))


def _read(path: Path) -> LoadedScene:
    kind = file_kind(path)
    form = find_format(kind)
    if form is not None and form.scene_type is not None:
        scene: Any = read_with(form, path)
        if not issubclass(type(scene), form.scene_type):
            actual, expected = type(scene).__name__, form.scene_type.__name__
            suffix = FORMATS.provider_suffix(form.name)
            raise InvalidValueError(f"file format '{form.name}'{suffix} returned {actual}, not {expected}")
        return LoadedScene(kind, as_scene(scene), None)
    if form is not None:
        content = read_content(path)
        scene = SplatScene(
            content.splats,
            background=background_of(path),
            coding=_coding(path, kind, content.splats),
            antialiased=content.antialiased,
            origin=content.origin,
            metadata=content.metadata,
        )
        return LoadedScene(kind, scene, None)
    if kind in STREAMS:
        received = decode_stream(read_stream(path)[0].require_static(path))
        return LoadedScene(kind, received, received.loss_mask)
    check_scene_kind(path)
    return LoadedScene(kind, *load_scene_file(path))


def background_of(path: Path) -> Background:
    """Returns the background colour with which a scene of 3DGS was trained.

    Args:
        path: The model folder, its folder `point_cloud`, an `iteration_N` in it, or the PLY in that.

    Returns:
        The colour; black for any other file, and, with a warning, if `cfg_args` cannot be read.
    """
    ply = trained_ply(path) if path.is_dir() else path
    folder = None if ply is None else model_folder_of(ply)
    if folder is None:
        return BLACK
    try:
        return load_background(folder)
    except (DatasetError, OSError) as error:
        LOG.warning("%s; the background is black", error)
        return BLACK


def _coding(path: Path, kind: Kind, splats: Splats) -> SplatCoding | None:
    """Returns the quantisation settings that a PLY of decoded Gaussians stores; None if the file has none.

    Args:
        path: The file.
        kind: Detected kind of the file.
        splats: Gaussians read from the file.
    """
    steps = read_ply_steps(path) if kind is SPLATS_PLY else None
    if steps is None or len(steps.classes) != splats.num_gaussians:
        return None
    return coding_from_bytes(steps.content, steps.classes, splats.degree)


def _gaps_error(path: Path, lost: int, parts: str) -> BitstreamError:
    how = "`splatwire decode --conceal NAME`, or in Python `open_scene(path, conceal=NAME)`"
    return BitstreamError(f"{path}: {lost:,} of the {parts} were lost; conceal it first: {how}")
