"""Writing of scenes to files."""

import logging
import os
from pathlib import Path

from splatwire.anchors.appearance import (
    antialiased,
    as_scene,
    check_drawable,
    explicit_gaussians,
    metadata_of,
    origin_of,
    scene_of,
)
from splatwire.anchors.scene_file import save_partial
from splatwire.anchors.scene_file import save_scene as save_anchors
from splatwire.arguments import checked, checked_except
from splatwire.bitstream.stream import FILE_SUFFIX
from splatwire.codec.gaussians.coding import coding_to_bytes
from splatwire.concealment import Concealer, conceal
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.files.names import path_of
from splatwire.files.scene_formats import FORMATS
from splatwire.io.formats import PlySteps, write_splats
from splatwire.io.formats.dispatch import format_for, warn_of_background, write_with
from splatwire.io.formats.outliers import DEFAULT, Outliers
from splatwire.types import LossMask, Prior, ReceivedScene, SplatCoding
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
SCENE_SUFFIX = ".scene"
"""Default suffix of scene files."""


@checked_except("path")
def save_scene(
    scene: Scene | ReceivedScene | Splats,
    path: str | os.PathLike[str],
    *,
    loss_mask: LossMask | None = None,
    outliers: Outliers = DEFAULT,
) -> None:
    """Writes a scene atomically, in a format that `open_scene` reads.

    Args:
        scene: The scene. Anchors are written losslessly. Explicit Gaussians are written in the format of the file
            name's suffix, such as `.ply`, `.compressed.ply`, `.spz` or `.sog`. Changes by loss concealment are
            included; Gaussians that it hides, and lost ones without concealment, are omitted. A `.ply` of decoded
            Gaussians can be encoded again without loss.
        path: Path of the file.
        loss_mask: Loss mask before concealment, for information; only scene files of anchors store it.
        outliers: Treatment of Gaussians with extreme values, as for `splatwire.io.formats.write_splats`.

    Raises:
        InvalidValueError: If the scene or path has a wrong type, the folder does not exist, the suffix belongs to
            another kind of file, or there is no Gaussian to write.
        UnknownNameError: If no format of explicit Gaussians has the suffix.
        OSError: If the file cannot be written.
    """
    shown: Scene | ReceivedScene = scene if isinstance(scene, ReceivedScene) else as_scene(scene)
    check_drawable(scene_of(shown))
    target = path_of(path)
    if target.name.lower().endswith(FILE_SUFFIX):
        raise InvalidValueError(
            f"{target}: the name says a stream, which `write_stream(encode_scene(scene), path)` writes"
        )
    if isinstance(shown, ReceivedScene) and not _can_record_losses(shown):
        if num_lost := shown.loss_mask.num_lost:
            LOG.warning("%s: %d lost Gaussians are left out, and such files cannot record losses", target, num_lost)
        shown = conceal(shown, "drop")
    if not isinstance(shown, ReceivedScene) and _saved_as_own_type(shown, target):
        return
    if not isinstance(shown, ReceivedScene) and (splats := explicit_gaussians(shown)) is not None:
        if loss_mask is not None and loss_mask.num_lost:
            LOG.warning(
                "%s: such files cannot record losses: the %d Gaussians that were lost look like received ones",
                target, loss_mask.num_lost,
            )  # fmt: skip
        warn_of_background(target, shown.background)
        write_splats(
            [splats],
            target,
            _ply_steps_of(shown),
            antialiased=antialiased(shown),
            origin=origin_of(shown),
            outliers=outliers,
            metadata=metadata_of(shown),
        )
        return
    if target.name.lower().endswith(tuple(form.suffix for form in FORMATS.registered().values())):
        raise InvalidValueError(
            f"{target}: the name says another kind of file than a scene of anchors, which would be in it; explicit "
            "Gaussians are written by `splatwire export`"
        )
    if isinstance(shown, ReceivedScene):
        save_partial(shown, target)
    else:
        save_anchors(shown, target, loss_mask=loss_mask)


def _saved_as_own_type(scene: Scene, target: Path) -> bool:
    """Writes a scene in a format for a special type of scene, if the file name has the suffix of such a format.

    Packages can register such formats (`FileFormat.scene_type`).

    Returns:
        True if the scene was written; False if no such format has the suffix.

    Raises:
        InvalidValueError: If the format with this suffix is for scenes of another type.
    """
    if target.suffix in ("", SCENE_SUFFIX):
        return False
    try:
        form = format_for(target)
    except UnknownNameError:
        return False
    if form.scene_type is None:
        return False
    if not isinstance(scene, form.scene_type):
        type_name = type(scene).__name__
        raise InvalidValueError(
            f"{target}: {form.description} holds scenes of the type {form.scene_type.__name__}, not {type_name}"
        )
    write_with(form, scene, target)
    return True


def _ply_steps_of(scene: Scene) -> PlySteps | None:
    """Returns the quantisation steps of decoded Gaussians, to store in a PLY.

    The result is None if the steps are unknown, or loss concealment has enlarged Gaussians after decoding. Estimates of
    lost Gaussians are not noticed.
    """
    coding: SplatCoding | None = getattr(scene, "coding", None)
    if coding is None:
        return None
    if scene.hints is not None:
        if scene.hints.opacity_gain is not None or not bool((scene.hints.size_gain == 1).all()):
            return None
        coding = coding.select(~scene.hints.left_out)
    return PlySteps(coding_to_bytes(coding), coding.precision_classes)


def _can_record_losses(received: ReceivedScene) -> bool:
    """True for neural anchors, which have a `Prior`: only their scene files can mark lost elements."""
    return received.get(Prior) is not None


@checked
def save_decoded(
    received: ReceivedScene, concealer: Concealer | None, path: Path, *, outliers: Outliers = DEFAULT
) -> Scene:
    """Writes a decoded stream to a file, after concealment if a concealer is given.

    Args:
        received: Decoded anchors or explicit Gaussians, with lost elements marked.
        concealer: Concealer of lost elements. If None, lost anchors are marked in the file, and lost Gaussians are
            omitted.
        path: Path of the file.
        outliers: Treatment of Gaussians with extreme values, as for `splatwire.io.formats.write_splats`.

    Returns:
        The scene, after concealment if there was any. Lost Gaussians that the file omits are still in it, invisible.

    Raises:
        InvalidValueError: If the concealer does not support these elements.
        SplatwireError: See `save_scene`.
        OSError: If the file cannot be written.
    """
    if concealer is None and _can_record_losses(received):
        save_scene(received, path, outliers=outliers)
        return received.scene
    scene = conceal(received, concealer or "drop")
    recorded = received.loss_mask if explicit_gaussians(scene) is None else None  # callers report losses of Gaussians
    save_scene(scene, path, loss_mask=recorded, outliers=outliers)
    return scene
