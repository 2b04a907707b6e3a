"""Selection of the reader or writer of explicit Gaussians, by detected format or suffix."""

import importlib
import logging
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.arguments import checked
from splatwire.errors import MALFORMED, DatasetError, InvalidValueError, UnknownNameError
from splatwire.files.atomic_write import atomic_output
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
    USD,
    Kind,
    file_kind,
    format_error,
    kind_of_format,
    opened,
    trained_ply,
)
from splatwire.files.names import path_of
from splatwire.files.scene_formats import FORMATS, FileFormat
from splatwire.io.formats._placement import warn_of_files_beside
from splatwire.io.formats.compressed_ply import content_of_chunks, write_compressed_ply
from splatwire.io.formats.content import FileContent, warn_of_distant_sites, warn_of_rounded_positions
from splatwire.io.formats.outliers import DEFAULT, Outliers, check_outliers
from splatwire.io.formats.ply import (
    content_of_vertices,
    orbit_of_elements,
    warn_of_colour_space,
    warn_of_other_gaussians,
    write_ply,
)
from splatwire.io.formats.ply_file import read_ply_elements
from splatwire.io.formats.ply_steps import PlySteps
from splatwire.io.model_arguments import load_antialiasing
from splatwire.plugins import source_of
from splatwire.types.background import BLACK, Background
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin, describe_origin
from splatwire.types.splats import Splats
from splatwire.types.validity import ElementValidity, invalid_fields, validity_of_splats

LOG = logging.getLogger(__name__)


@checked
def find_format(kind: Kind) -> FileFormat | None:
    """Returns the registered scene format of a detected kind of file; None if there is none.

    For a PLY of anchors or without Gaussians it is `ply`, whose reader rejects the file with a message of its own.
    """
    for form in FORMATS.registered().values():
        if kind in form.kinds or (form.recognises is not None and kind == kind_of_format(form)):
            return form
    return None


@checked
def format_of(kind: Kind) -> str | None:
    """Returns the name of the scene format that files of a detected kind have.

    The result is None if no format of explicit Gaussians has this kind. For any PLY it is `ply`, also for one of
    anchors or without Gaussians, which the reader rejects.
    """
    form = find_format(kind)
    return None if form is None or form.scene_type is not None else form.name


@checked
def splats_kind(path: Path) -> str | None:
    """Detects the format of a file of explicit Gaussians by its content.

    Returns:
        Name of the format, such as `ply` or `spz`; None for anything else, including missing files. Any PLY is a `ply`
        (compressed, of anchors, or without Gaussians: the reader rejects the last two), a glTF document a `glb`, and a
        3DGS model folder a `3dgs`.
    """
    return format_of(file_kind(path))


@checked
def read_splats(path: Path) -> Splats:
    """Reads explicit Gaussians of any supported format, in world coordinates.

    Raises:
        DatasetError: As for `read_content`.
    """
    return read_content(path).relative_to(NO_ORIGIN).splats


@checked
def read_content(path: Path) -> FileContent:
    """Reads explicit Gaussians of any supported format, with axes as in a 3DGS PLY (RDF).

    Invisible and invalid Gaussians are removed and logged. If positions are far from 0, the result has an origin near
    the Gaussians, so that float32 suffices for positions relative to this origin.

    Raises:
        DatasetError: If the format is not supported, the file is damaged, or no Gaussian can be drawn.
    """
    path = path_of(path, "a file of Gaussians")
    content, validity = read_rows_with_origin(path)
    # The file of an empty frame has one invisible Gaussian, see `splatwire.sequence.frame_writer`.
    if len(validity.kept) == validity.num_invisible == 1:
        LOG.warning("%s: its only Gaussian is transparent: the scene is empty", path)
        return content
    validity.log_removed(path, "Gaussians")
    if not bool(validity.kept.any()):
        counts = f"{validity.num_invisible:,} draw nothing, {validity.num_invalid:,} cannot be drawn"
        fields = ", ".join(invalid_fields(content.splats))
        why = f" (invalid: {fields})" if fields else ""
        raise DatasetError(f"{path}: none of its {len(validity.kept):,} Gaussians is left: {counts}{why}")
    return content if validity.all_drawable else replace(content, splats=content.splats.gathered(validity.kept))


@checked
def is_antialiased(path: Path) -> bool:
    """Returns True if a file declares that its scene was trained with antialiased rendering (Mip-Splatting).

    This rendering lowers the opacity of Gaussians that it widens to a pixel.

    Raises:
        DatasetError: If it is a damaged file of explicit Gaussians.
    """
    form = find_format(file_kind(path))
    return form is not None and form.scene_type is None and _content(form, path).antialiased


@checked
def read_rows(path: Path) -> tuple[Splats, ElementValidity]:
    """Reads all Gaussians of a file in world coordinates, including those that cannot be drawn.

    Returns:
        The Gaussians; and the classification of each as drawable, invisible or invalid.

    Raises:
        DatasetError: If the format is not supported, or the file is damaged.
    """
    content, validity = read_rows_with_origin(path)
    return content.relative_to(NO_ORIGIN).splats, validity


@checked
def read_rows_with_origin(path: Path) -> tuple[FileContent, ElementValidity]:
    """Reads all Gaussians of a file, and classifies each as drawable, invisible or invalid.

    Raises:
        DatasetError: If the format is not supported, or the file is damaged.
    """
    try:
        with (
            opened(path) as source,
            np.errstate(over="ignore", invalid="ignore"),
        ):  # invalid values are classified later
            form = find_format(file_kind(source))
            if form is None or form.scene_type is not None:
                raise DatasetError(format_error(path, "a file of explicit Gaussians"))
            content_in_file = _content(form, source)
            content = content_in_file.with_chosen_origin()
            if content_in_file.origin == NO_ORIGIN:
                warn_of_rounded_positions(path, content.splats, content.origin)
            warn_of_distant_sites(path, content.splats, content.origin)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror or error}") from error
    except InvalidValueError as error:
        raise DatasetError(f"{path}: {error}") from error
    return content, validity_of_splats(content.splats)


def _read_model(folder: Path) -> FileContent:
    """Reads the PLY of the last iteration in a 3DGS model folder.

    Args:
        folder: The model folder, its folder `point_cloud`, or an `iteration_N` in it.
    """
    return _read_ply(_last_iteration(folder))


def _read_ply(path: Path) -> FileContent:
    """Reads a PLY, with the antialiasing that the PLY or the training arguments of its model folder state."""
    content = _read_ply_alone(path)
    if content.antialiased:
        return content
    try:
        return replace(content, antialiased=load_antialiasing(path))
    except (DatasetError, OSError) as error:
        LOG.warning("%s; the scene is drawn without antialiasing", error)
        return content


def _last_iteration(folder: Path) -> Path:
    """Returns the PLY file of the last training iteration in a 3DGS model folder.

    Raises:
        DatasetError: If the PLY was removed in the meantime.
    """
    path = trained_ply(folder)
    if path is None:
        raise DatasetError(f"{folder}: has no point_cloud/iteration_*/point_cloud.ply")
    return path


def _read_ply_alone(path: Path) -> FileContent:
    """Reads a PLY of Gaussians, compressed or not, without the training arguments of its model folder.

    Raises:
        DatasetError: If the file is damaged, or has no Gaussians.
    """
    elements = read_ply_elements(path)
    warn_of_files_beside(path)
    vertices = elements.get("vertex")
    # If the vertices have plain x, y, z, an element `chunk` is not that of a compressed PLY.
    if "chunk" in elements and (vertices is None or "x" not in vertices.names):
        return content_of_chunks(elements)
    if vertices is None:
        raise DatasetError(f"{path}: has no element vertex")
    warn_of_colour_space(elements)
    warn_of_other_gaussians(elements)
    content, orbit = content_of_vertices(vertices), orbit_of_elements(elements)
    return content if orbit is None else replace(content, metadata=replace(content.metadata, orbit=orbit))


def _content(file_format: FileFormat, path: Path) -> FileContent:
    """Reads explicit Gaussians with the reader of `file_format`, and checks the type of the result.

    Raises:
        DatasetError: If the file is damaged.
        InvalidValueError: If a reader of another package returned a wrong type.
    """
    content = read_with(file_format, path)
    if isinstance(content, Splats):
        return FileContent(content)
    if not isinstance(content, FileContent):
        what = f"file format '{file_format.name}'{FORMATS.provider_suffix(file_format.name)}"
        raise InvalidValueError(f"{what} returned {type(content).__name__}, not FileContent or Splats")
    return content


def read_with(file_format: FileFormat, path: Path) -> Any:
    """Reads a file with the reader of its format.

    Common exceptions of readers of other packages, such as ValueError, are converted to DatasetError.

    Raises:
        DatasetError: If the file cannot be read.
    """
    assert file_format.read is not None
    if file_format.recognises is None:
        return file_format.read(path)
    try:
        return file_format.read(path)
    except MALFORMED as error:
        raise DatasetError(f"{path}: file format '{file_format.name}' cannot read it: {error}") from error


def format_named(name: str) -> FileFormat:
    """Returns a format of explicit Gaussians that can be written.

    Raises:
        UnknownNameError: If no writable format has that name.
    """
    form = FORMATS.find(name)
    if form is None or form.write is None or form.scene_type is not None:
        written = [
            file_format.name
            for file_format in FORMATS.all().values()
            if file_format.write and file_format.scene_type is None
        ]
        raise UnknownNameError("format of explicit Gaussians", name, written)
    return form


@checked
def format_for(path: str | os.PathLike[str]) -> FileFormat:
    """Returns the writable scene format for a file name, by its suffix.

    If several formats match, the one with the longest suffix is returned: `.compressed.ply` has priority over `.ply`.

    Raises:
        UnknownNameError: If no writable format matches.
    """
    name = path_of(path, "a file of Gaussians").name.lower()
    for formats in (FORMATS.registered, FORMATS.all):
        writable = [form for form in formats().values() if form.write is not None]
        for form in sorted(writable, key=lambda form: len(form.suffix), reverse=True):
            if name.endswith(form.suffix):
                return form
    raise UnknownNameError("format of explicit Gaussians", name, [form.suffix[1:] for form in writable])


@checked
def write_splats(
    parts: Iterable[Splats],
    path: Path,
    steps: PlySteps | None = None,
    *,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    outliers: Outliers = DEFAULT,
    metadata: SceneMetadata = NO_METADATA,
) -> int:
    """Writes explicit Gaussians in the format of the file name's suffix.

    Properties that a format cannot store cause a warning.

    Args:
        parts: Batches of Gaussians, all of one degree of spherical harmonics; may be a generator.
        path: Path of the file, written atomically.
        steps: Quantisation steps to store in a PLY.
        antialiased: True if the scene was trained with antialiased rendering (Mip-Splatting), which lowers the opacity
            of Gaussians that it widens to a pixel. PLY, SPZ and SOG store this flag.
        origin: World coordinates of the point that positions are relative to. A PLY stores float64 world coordinates.
        outliers: Treatment of a few Gaussians with extreme values, which reduce the precision of all others in
            quantised formats: `clamp` moves them towards the others, `prune` removes them, `keep` leaves them
            unchanged.
        metadata: Metadata of the scene; the initial view is relative to `origin`.

    Returns:
        Number of Gaussians written.

    Raises:
        UnknownNameError: If no supported format has the suffix.
        InvalidValueError: If there is no Gaussian, a number is not finite, degrees differ, or the format is for another
            type of scene.
        OSError: If the file cannot be written.
    """
    form = format_for(path)
    if form.scene_type is not None:
        held = form.scene_type.__name__
        raise InvalidValueError(f"{path}: {form.description} holds scenes of the type {held}, not explicit Gaussians")
    properties = storable_properties(
        form, path, antialiased=antialiased, origin=origin, outliers=outliers, metadata=metadata, steps=steps
    )
    return write_with(form, parts, path, **properties)


def write_with(file_format: FileFormat, content: Any, path: Path, **properties: Any) -> int:
    """Writes a file atomically with the writer of its format.

    Args:
        file_format: The format.
        content: Batches of explicit Gaussians, or a scene of the format's type.
        path: The file.
        **properties: Scene properties for the writer, from `storable_properties`.

    Returns:
        Number of Gaussians written; 0 if a writer of another package does not return it.
    """
    assert file_format.write is not None
    if file_format.recognises is None:
        return int(file_format.write(content, path, **properties))
    with atomic_output(path) as target:
        count = file_format.write(content, target, **properties)
        if not target.exists():
            raise InvalidValueError(
                f"file format '{file_format.name}'{FORMATS.provider_suffix(file_format.name)} wrote no file"
            )
    return count if isinstance(count, int) else 0


def storable_properties(
    file_format: FileFormat,
    path: Path,
    *,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    outliers: Outliers = DEFAULT,
    metadata: SceneMetadata = NO_METADATA,
    steps: PlySteps | None = None,
) -> dict[str, Any]:
    """Selects the properties of a scene that a file format can store, and logs a warning about the other properties.

    Args:
        file_format: The file format.
        path: The file, for warnings.
        antialiased: True if the scene was trained with antialiased rendering.
        origin: World coordinates of the point that positions are relative to.
        outliers: Treatment of extreme values in quantised formats.
        metadata: Metadata of the scene.
        steps: Quantisation steps with which the scene was decoded; None if unknown.

    Returns:
        The selected properties, as keyword arguments of the format's writer.
    """
    treatment = check_outliers(outliers)
    properties: dict[str, Any] = {"outliers": treatment} if "outliers" in file_format.write_options else {}
    if steps is not None and "steps" in file_format.write_options:
        properties["steps"] = steps
    if antialiased and "antialiased" in file_format.write_options:
        properties["antialiased"] = True
    if antialiased and file_format.name == "glb":
        warn_of_antialiasing_in_extras(path)
    elif antialiased and "antialiased" not in file_format.write_options:
        LOG.warning("%s: such files cannot ask for antialiasing, as the scene does: PLY, SPZ and SOG can", path)
    if origin != NO_ORIGIN and "origin" in file_format.write_options:
        properties["origin"] = origin
    if origin != NO_ORIGIN and not has_world_coordinates(file_format):
        where = "only splatwire reads from such files" if "origin" in properties else "such files do not hold"
        LOG.warning(
            "%s: positions are relative to the scene's origin (%s), which %s; PLY and glTF have world coordinates",
            path, describe_origin(origin).replace(" ", ", "), where,
        )  # fmt: skip
    if (stated := metadata.known()) and "metadata" in file_format.write_options:
        properties["metadata"] = metadata
    elif stated:
        LOG.warning("%s: such files have no place for metadata: %s will be lost", path, ", ".join(stated))
    return properties


def has_world_coordinates(file_format: FileFormat) -> bool:
    """True if files of a format have positions that other programs read as world coordinates, as PLY and glTF."""
    return "origin" in file_format.write_options and file_format.name not in _OWN_ORIGIN


def warn_of_antialiasing_in_extras(path: Path) -> None:
    """Logs a warning that other programs draw an antialiased scene in glTF without antialiasing."""
    LOG.warning("%s: the request for antialiasing is in extras, which other programs do not read", path)


def warn_of_background(path: Path, background: Background) -> None:
    """Logs a warning if a scene has a background colour, because files of explicit Gaussians cannot store one."""
    if background != BLACK:
        LOG.warning(
            "%s: such files have no background colour: that of the scene (%s) will be lost",
            path, ", ".join(f"{value:.3g}" for value in background),
        )  # fmt: skip


@checked
def register_format(form: FileFormat) -> FileFormat:
    """Registers a file format of another package.

    Args:
        form: The format, with a detector and a reader or writer.

    Returns:
        The format itself, unchanged.

    Raises:
        InvalidValueError: If a part is missing or invalid, or the name is taken.
    """
    if wrong := _problem(form):
        raise InvalidValueError(f"file format {form.name!r:.40} is not complete: {wrong}")
    FORMATS.register(form.name, form, source_of(form.read or form.write))
    return form


def _problem(file_format: FileFormat) -> str:
    """Returns a message about a missing or invalid part of a registered format, or an empty text if there is none."""
    if not isinstance(file_format.name, str) or not re.fullmatch(
        "[a-z0-9][a-z0-9_.]{0,31}", file_format.name, re.ASCII
    ):
        return "its name must be 1 to 32 lower-case letters, digits, dots and underscores"
    if not isinstance(file_format.description, str) or not file_format.description:
        return "its description must name such a file, such as 'an SPZ file'"
    if file_format.read is None and file_format.write is None:
        return "it neither reads nor writes"
    if file_format.recognises is None:
        return "recognises is missing"
    called = ("recognises", "read", "write")
    wrong = [
        name for name in called if getattr(file_format, name) is not None and not callable(getattr(file_format, name))
    ]
    if wrong:
        return f"{', '.join(wrong)} cannot be called"
    if file_format.scene_type is not None and not isinstance(file_format.scene_type, type):
        return f"scene_type must be a class, not {file_format.scene_type!r:.40}"
    if not isinstance(file_format.write_options, frozenset | set | tuple | list) or not all(
        isinstance(k, str) for k in file_format.write_options
    ):
        return "write_options must be a set of names"
    unknown = sorted(set(file_format.write_options) - _PROPERTIES)
    return f"write_options has {', '.join(unknown)}; known are {', '.join(sorted(_PROPERTIES))}" if unknown else ""


_OWN_ORIGIN = ("compressed.ply", "spz", "sog")
"""Formats with the origin only in a comment or metadata of this package."""
_PROPERTIES = frozenset(("antialiased", "metadata", "steps", "origin", "outliers"))


def _lazy_import(module: str, name: str) -> Callable[..., Any]:
    """Wraps a reader or writer of `splatwire.io.formats` to import the module at the first call."""

    def call(*arguments: Any, **properties: Any) -> Any:
        return getattr(importlib.import_module(f"splatwire.io.formats.{module}"), name)(*arguments, **properties)

    return call


_EXPLICIT = (
    FileFormat(
        "ply",
        "a PLY",
        read=lambda path: _read_ply(path),
        write=write_ply,
        kinds=(SPLATS_PLY, ANCHORS_PLY, COMPRESSED_PLY, OTHER_PLY),
        write_options=_PROPERTIES - {"outliers"},
    ),
    FileFormat("compressed.ply", "a compressed PLY", write=write_compressed_ply, write_options=_PROPERTIES - {"steps"}),
    FileFormat(
        "spz",
        "an SPZ file",
        read=_lazy_import("spz", "read_spz"),
        write=_lazy_import("spz_writer", "write_spz"),
        kinds=(SPZ,),
        write_options=_PROPERTIES - {"steps"},
    ),
    FileFormat(
        "sog",
        "a SOG file",
        read=_lazy_import("sog", "read_sog"),
        write=_lazy_import("sog_writer", "write_sog"),
        kinds=(SOG, SOG_FOLDER, SOG_META),
        write_options=_PROPERTIES - {"steps"},
    ),
    FileFormat(
        "streamed sog", "a streamed SOG", read=_lazy_import("streamed_sog", "read_streamed_sog"), kinds=(SOG_LEVELS,)
    ),
    FileFormat(
        "splat",
        "a .splat file",
        read=_lazy_import("splat", "read_splat"),
        write=_lazy_import("splat", "write_splat"),
        kinds=(SPLAT,),
    ),
    FileFormat("ksplat", "a .ksplat file", read=_lazy_import("ksplat", "read_ksplat"), kinds=(KSPLAT,)),
    FileFormat(
        "glb",
        "a glTF file",
        read=_lazy_import("gltf", "read_gltf"),
        write=_lazy_import("gltf_writer", "write_gltf"),
        kinds=(GLB, GLTF),
        write_options=_PROPERTIES - {"steps", "outliers"},
    ),
    *(
        FileFormat(
            name,
            "an OpenUSD scene",
            read=_lazy_import("usd", "read_usd"),
            write=_lazy_import("usd", "write_usd"),
            kinds=(USD,) if name == "usd" else (),
            write_options=frozenset(("origin", "metadata")),
        )
        for name in ("usd", "usda", "usdc", "usdz")
    ),
    FileFormat("3dgs", "a model folder of 3DGS", read=_read_model, kinds=(MODEL_3DGS,)),
)
for _form in _EXPLICIT:
    FORMATS.register(_form.name, _form, f"{__name__}.{_form.name}")
