"""Scenes to files."""

import os
from pathlib import Path

from splatwire.codec.schemas.gaussians.coding import coding_to_bytes
from splatwire.conceal import Concealer, conceal
from splatwire.errors import InvalidValueError
from splatwire.formats import PlyNote, write_splats
from splatwire.formats.kinds import READERS, WRITERS
from splatwire.formats.outliers import DEFAULT, Outliers
from splatwire.model import Partial, Prior, SplatCoding
from splatwire.model.appearance import Scene, antialiased, as_scene, explicit_gaussians, metadata_of, origin_of
from splatwire.model.scene_file import save_partial
from splatwire.model.scene_file import save_scene as save_anchors
from splatwire.packets.stream import FILE_SUFFIX
from splatwire.scene import Erasures
from splatwire.scene.splats import Splats

_OTHERS = (FILE_SUFFIX, *(f".{end}" for end in {**READERS, **WRITERS}))
"""Ends of names that say something else than a scene file."""


def save_scene(
    scene: Scene | Partial | Splats,
    path: str | os.PathLike[str],
    *,
    erasures: Erasures | None = None,
    outliers: Outliers = DEFAULT,
) -> None:
    """Writes a scene so that `open_scene` reads it; the file appears under its name when it is complete.

    Args:
        scene: Anchors become a scene file, exactly, with their gaps if they have some. Explicit Gaussians are written
            in the format that the end of the name says (`.ply`, `.compressed.ply`, `.spz`, `.sog`, `.splat`), as they
            are drawn: those that were lost or that a concealer leaves out are not in it. A `.ply` of decoded ones
            keeps what they were rounded to, so that they are encoded to the same integers again.
        path: The file.
        erasures: What had been received before losses were concealed; a scene file keeps it for the record.
        outliers: See `splatwire.formats.write_splats`.

    Raises:
        InvalidValueError: If it is no scene, the name says another kind of file, or there is no Gaussian to write.
        UnknownNameError: If the name says no format of explicit Gaussians.
        OSError: If the file cannot be written.
    """
    shown: Scene | Partial = scene if isinstance(scene, Partial) else as_scene(scene)
    target = Path(path)
    if isinstance(shown, Partial) and shown.find(Prior) is None:
        shown = conceal(shown, "drop")
    if not isinstance(shown, Partial) and (splats := explicit_gaussians(shown)) is not None:
        write_splats(
            [splats],
            target,
            _note_of(shown),
            antialiased=antialiased(shown),
            origin=origin_of(shown),
            outliers=outliers,
            metadata=metadata_of(shown),
        )
        return
    if target.name.lower().endswith(_OTHERS):
        raise InvalidValueError(
            f"{target}: the name says another kind of file than a scene of anchors, which would be in it; streams are "
            "written by `write_stream(encode_scene(scene), path)`, explicit Gaussians by `splatwire export`"
        )
    if isinstance(shown, Partial):
        save_partial(shown, target)
    else:
        save_anchors(shown, target, erasures=erasures)


def _note_of(scene: Scene) -> PlyNote | None:
    """What decoded Gaussians were rounded to, if they are drawn as they were decoded."""
    coding: SplatCoding | None = getattr(scene, "coding", None)
    if coding is None:
        return None
    if scene.hints is not None:
        if scene.hints.opacity_gain is not None or not bool((scene.hints.size_gain == 1).all()):
            return None
        coding = coding.select(~scene.hints.left_out)
    return PlyNote(coding_to_bytes(coding), coding.classes)


def save_decoded(partial: Partial, concealer: Concealer | None, path: Path, *, outliers: Outliers = DEFAULT) -> Scene:
    """Writes what a decoder returned.

    Args:
        partial: Anchors, or explicit Gaussians.
        concealer: What hides the gaps; None keeps those of anchors in the file, and leaves lost Gaussians out.
        path: Where to.
        outliers: See `splatwire.formats.write_splats`.

    Returns:
        The scene in the file; of Gaussians, with those that were left out.

    Raises:
        InvalidValueError: If the concealer is not for these elements.
        SplatwireError: See `save_scene`.
        OSError: If the file cannot be written.
    """
    if concealer is None and partial.find(Prior) is not None:
        save_scene(partial, path, outliers=outliers)
        return partial.scene
    scene = conceal(partial, concealer or "drop")
    save_scene(scene, path, erasures=partial.erasures, outliers=outliers)
    return scene
