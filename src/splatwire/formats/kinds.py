"""Which format a file has, told by its first bytes, and its reader and writer."""

import logging
import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError, UnknownNameError
from splatwire.files.kinds import (
    ANCHORS_PLY,
    COMPRESSED_PLY,
    GLB,
    GLTF,
    KSPLAT,
    MODEL_3DGS,
    OTHER_PLY,
    SOG,
    SOG_FOLDER,
    SOG_LEVELS,
    SOG_META,
    SPLAT,
    SPLATS_PLY,
    SPZ,
    Kind,
    file_kind,
    is_not,
    trained_ply,
)
from splatwire.formats import sog, spz, streamed_sog
from splatwire.formats._sog_writer import write_sog
from splatwire.formats.compressed_ply import content_of_chunks, write_compressed_ply
from splatwire.formats.content import FileContent
from splatwire.formats.gltf import read_gltf
from splatwire.formats.gltf_writer import write_gltf
from splatwire.formats.ksplat import read_ksplat
from splatwire.formats.outliers import DEFAULT, Outliers, check_outliers
from splatwire.formats.ply import content_of_vertices, write_ply
from splatwire.formats.ply_comments import states_antialiasing
from splatwire.formats.ply_file import read_ply_comments, read_ply_elements
from splatwire.formats.ply_note import PlyNote
from splatwire.formats.sog import read_sog
from splatwire.formats.splat import read_splat, write_splat
from splatwire.formats.spz import read_spz
from splatwire.formats.spz_writer import write_spz
from splatwire.formats.streamed_sog import read_streamed_sog
from splatwire.scene.metadata import NO_METADATA, SceneMetadata
from splatwire.scene.origin import NO_ORIGIN, Origin, describe_origin
from splatwire.scene.rows import Rows, rows_of_splats
from splatwire.scene.splats import Splats

LOG = logging.getLogger(__name__)
Writer = Callable[[Iterable[Splats], Path], int]
KINDS = {
    "ply": (SPLATS_PLY, ANCHORS_PLY, COMPRESSED_PLY, OTHER_PLY),
    "spz": (SPZ,),
    "sog": (SOG, SOG_FOLDER, SOG_META),
    "streamed sog": (SOG_LEVELS,),
    "splat": (SPLAT,),
    "ksplat": (KSPLAT,),
    "glb": (GLB, GLTF),
    "3dgs": (MODEL_3DGS,),
}
"""What may hold explicit Gaussians, by reader, which says more of it."""
READERS: dict[str, Callable[[Path], FileContent]] = {
    "ply": lambda path: _read_ply(path),
    "spz": read_spz,
    "sog": read_sog,
    "streamed sog": read_streamed_sog,
    "splat": lambda path: FileContent(read_splat(path)),
    "ksplat": lambda path: FileContent(read_ksplat(path)),
    "glb": read_gltf,
    "3dgs": lambda path: _read_ply(_trained(path)),
}
"""Of all rows of a file; `read_all_rows` judges them."""
WRITERS: dict[str, Writer] = {
    "ply": write_ply,
    "compressed.ply": write_compressed_ply,
    "spz": write_spz,
    "sog": write_sog,
    "splat": write_splat,
    "glb": write_gltf,
}
"""By the end of a file's name."""
QUANTISED: tuple[Writer, ...] = (write_compressed_ply, write_spz, write_sog)
"""Writers of formats with steps that are relative to the range of all values."""


def format_of(kind: Kind) -> str | None:
    """Name of the format of explicit Gaussians that a kind of file is, a key of `KINDS`; None if it is none."""
    return next((name for name, kinds in KINDS.items() if kind in kinds), None)


def splats_kind(path: Path) -> str | None:
    """Tells by its bytes whether a file holds explicit Gaussians (`splatwire.files.kinds`).

    Returns:
        `ply`, `spz`, `sog` (also for a folder with its `meta.json`, or that file), `streamed sog`, `splat`, `ksplat`,
        `glb`, or None for anything else, also for what is not a file.
    """
    return format_of(file_kind(path))


def read_splats(path: Path) -> Splats:
    """Reads explicit Gaussians of any format that is known, in world coordinates; see `read_content`.

    Raises:
        DatasetError: See `read_content`.
    """
    return read_content(path).relative_to(NO_ORIGIN).splats


def read_content(path: Path) -> FileContent:
    """Reads explicit Gaussians of any format that is known, with axes as in a 3DGS PLY (RDF).

    Rows that draw nothing or cannot be drawn are left out, which is logged (`splatwire.scene.rows`). Positions far from
    0 are relative to an origin near them, so that float32 holds them.

    Raises:
        DatasetError: If the file is of none of them, damaged, or has no Gaussian that can be drawn; the message names
            what is wrong with which field.
    """
    content, rows = read_all_rows(path)
    rows.tell(path, "Gaussians")
    if not bool(rows.kept.any()):
        found = f"{rows.num_invisible:,} draw nothing, {rows.num_invalid:,} cannot be drawn"
        raise DatasetError(f"{path}: none of its {len(rows.kept):,} Gaussians is left: {found}")
    return content if rows.complete else replace(content, splats=content.splats.gathered(rows.kept))


def is_antialiased(path: Path) -> bool:
    """True if a file that was read says that its Gaussians lose opacity as they are widened to a pixel.

    SPZ and SOG have a flag, PLY has comments of training programs (`splatwire.formats.ply_comments`).
    """
    say: dict[str, Callable[[Path], bool]] = {
        "ply": lambda file: states_antialiasing(read_ply_comments(file)),
        "3dgs": lambda folder: states_antialiasing(read_ply_comments(_trained(folder))),
        "spz": spz.is_antialiased,
        "sog": sog.is_antialiased,
        "glb": lambda file: read_gltf(file).antialiased,
        "streamed sog": streamed_sog.is_antialiased,
    }
    asked = say.get(splats_kind(path) or "")
    return asked is not None and asked(path)


def read_rows(path: Path) -> tuple[Splats, Rows]:
    """Reads all rows of a file of explicit Gaussians in world coordinates, and judges them.

    Raises:
        DatasetError: If the file is of no format that is known, or damaged.
    """
    content, rows = read_all_rows(path)
    return content.relative_to(NO_ORIGIN).splats, rows


def read_all_rows(path: Path) -> tuple[FileContent, Rows]:
    """Reads all rows of a file of explicit Gaussians, and judges them; positions are relative to the content's origin.

    Raises:
        DatasetError: If the file is of no format that is known, or damaged.
    """
    kind = splats_kind(path)
    if kind is None:
        raise DatasetError(is_not(path, "a file of explicit Gaussians"))
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # numbers may lie; what comes out of them is judged
            content = READERS[kind](path).with_chosen_origin()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror or error}") from error
    return content, rows_of_splats(content.splats)


def _trained(folder: Path) -> Path:
    """The PLY of the last iteration of a model folder of 3DGS.

    Raises:
        DatasetError: If it was removed since the folder was recognised.
    """
    path = trained_ply(folder)
    if path is None:
        raise DatasetError(f"{folder}: has no point_cloud/iteration_*/point_cloud.ply")
    return path


def _read_ply(path: Path) -> FileContent:
    elements = read_ply_elements(path)
    if "chunk" in elements:
        return content_of_chunks(elements)
    if "vertex" not in elements:
        raise DatasetError(f"{path}: has no element vertex")
    return content_of_vertices(elements["vertex"])


def writer_for(path: str | os.PathLike[str]) -> Writer:
    """The writer of the format that the end of a file's name says; the longest end counts.

    Raises:
        UnknownNameError: If there is none.
    """
    name = Path(path).name.lower()
    for end in sorted(WRITERS, key=len, reverse=True):
        if name.endswith(f".{end}"):
            return WRITERS[end]
    raise UnknownNameError("format of explicit Gaussians", name, WRITERS)


def write_splats(
    parts: Iterable[Splats],
    path: Path,
    note: PlyNote | None = None,
    *,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    outliers: Outliers = DEFAULT,
    metadata: SceneMetadata = NO_METADATA,
) -> int:
    """Writes explicit Gaussians in the format that the end of the file's name says (`WRITERS`).

    Args:
        parts: The Gaussians, all of one degree; may be a generator: PLY and `.splat` are written part by
            part.
        path: The file; it appears under its name when it is complete.
        note: What is noted of them, in a PLY; other formats have no room for it.
        antialiased: Whether they lose opacity as they are widened to a pixel. PLY, SPZ and SOG say so; where a format
            cannot, a warning does.
        origin: World coordinates that positions are relative to. A PLY has float64 world coordinates; a warning says
            where a format cannot hold them.
        outliers: Treatment of few Gaussians that would cost all others precision, in the `QUANTISED` formats.
        metadata: Metadata of the scene; its view is relative to `origin`. A warning says where a format has no place
            for it.

    Returns:
        How many Gaussians were written.

    Raises:
        UnknownNameError: If the name says no format.
        InvalidValueError: If there is none, a number is not finite, or degrees differ.
        OSError: If the file cannot be written.
    """
    writer = writer_for(path)
    more = {} if note is None or writer is not write_ply else {"note": note}
    writer = stating(writer, path, antialiased=antialiased, origin=origin, outliers=outliers, metadata=metadata)
    return partial(writer, **more)(parts, path)


def stating(
    writer: Writer,
    path: Path,
    *,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    outliers: Outliers = DEFAULT,
    metadata: SceneMetadata = NO_METADATA,
) -> Writer:
    """Returns a writer with what is common to a file's Gaussians; a warning names what its format cannot hold.

    Arguments as of `write_splats`.
    """
    treatment = check_outliers(outliers)
    stated: dict[str, object] = {"outliers": treatment} if writer in QUANTISED else {}
    if antialiased and writer is not write_splat:
        stated["antialiased"] = True
    if antialiased and writer is write_gltf:
        LOG.warning("%s: the request for antialiasing is in extras, which other programs do not read", path)
    elif antialiased and writer is write_splat:
        LOG.warning("%s: such files cannot ask for antialiasing, as the scene does: PLY, SPZ and SOG can", path)
    if origin != NO_ORIGIN and writer in (write_ply, write_compressed_ply, write_gltf):
        stated["origin"] = origin
    if origin != NO_ORIGIN and writer not in (write_ply, write_gltf):
        where = "only a comment in such files holds" if "origin" in stated else "such files do not hold"
        LOG.warning(
            "%s: positions are relative to the scene's origin (%s), which %s; PLY and glTF have world coordinates",
            path, describe_origin(origin).replace(" ", ", "), where,
        )  # fmt: skip
    if (known := metadata.known()) and writer is not write_splat:
        stated["metadata"] = metadata
    elif known:
        LOG.warning("%s: such files have no place for metadata: %s will be lost", path, ", ".join(known))
    return partial(writer, **stated) if stated else writer
