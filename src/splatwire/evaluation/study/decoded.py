"""Results of other codecs: decoded scenes, or pictures of the views, with the number of bytes that the codec sends."""

import logging
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from splatwire.anchors.appearance import antialiased, scene_of
from splatwire.data.photos import check_photo, load_photo, photo_size
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.evaluation.extent import antialiasing_message
from splatwire.evaluation.study.definition import Decoded, Row, SceneEntry
from splatwire.evaluation.study.prepared_stream import PreparedStream, file_bytes
from splatwire.evaluation.study.references import References, digest_of_files
from splatwire.files.names import real_path
from splatwire.io import read_any_scene
from splatwire.io.opening import check_scene_kind
from splatwire.types.background import Background

LOG = logging.getLogger(__name__)
PICTURES = "pictures"
"""Name of the elements of a result that consists of pictures."""
SUFFIXES = (".png", ".jpg", ".jpeg")


def prepare_decoded(
    row: Row, entry: SceneEntry, references: References, is_antialiased: Callable[[], bool]
) -> PreparedStream | None:
    """Checks a result of another codec that the user provides: a decoded scene, or rendered pictures.

    Args:
        row: The table row of the other codec.
        entry: The scene.
        references: The reference images of the scene.
        is_antialiased: Function that returns True if the scene is drawn antialiased. A warning is logged if the
            decoded scene is not, or the other way round.

    Returns:
        Path, digest and size of the result; None if there is no result for the scene.

    Raises:
        SplatwireError: If the result cannot be read, or has no picture for a view.
    """
    if (decoded_file := check_decoded(row, entry)) is None:
        return None
    if references.frames:
        raise InvalidValueError(f"row '{row.key}': '{entry.name}' is a sequence, and results are for still scenes")
    path, digest = real_path(decoded_file.source), digest_of_files(decoded_file.source)
    if path.is_dir() and has_pictures(path):
        assert decoded_file.num_bytes is not None
        for file in picture_paths(path, references):
            check_photo(file)
            _check_size(file, photo_size(file), references.size)
        return PreparedStream(str(path), digest, {row.label: decoded_file.num_bytes}, 0, 0, elements=PICTURES)
    scene = scene_of(read_any_scene(path).loaded)
    if antialiased(scene) != is_antialiased():
        files = (path, entry.source) if antialiased(scene) else (entry.source, path)
        LOG.warning("%s", antialiasing_message(*files))
    size = file_bytes(path) if decoded_file.num_bytes is None else decoded_file.num_bytes
    return PreparedStream(
        str(path), digest, {row.label: size}, 0, scene.num_elements, scene.num_gaussians, elements=scene.ELEMENTS
    )


def check_decoded(row: Row, entry: SceneEntry) -> Decoded | None:
    """Checks the kind of a result of another codec, and returns its definition.

    Args:
        row: The table row of the other codec.
        entry: The scene.

    Returns:
        The definition; None if there is no result for the scene.

    Raises:
        SplatwireError: If the result is neither a scene nor pictures, or the number of bytes of pictures is not given.
    """
    decoded_file = next((decoded for decoded in row.decoded if decoded.scene == entry.name), None)
    if decoded_file is None:
        return None
    if not (decoded_file.source.is_dir() and has_pictures(decoded_file.source)):
        check_scene_kind(decoded_file.source)
    elif decoded_file.num_bytes is None:
        raise InvalidValueError(f"row '{row.key}': pictures need 'num_bytes', the bytes that the codec sends")
    return decoded_file


def has_pictures(folder: Path) -> bool:
    """Returns True if a folder contains rendered pictures."""
    # A folder with a `meta.json` is a scene in the format SOG, which also consists of picture files.
    return not (folder / "meta.json").is_file() and bool(_files(folder))


def picture_paths(folder: Path, references: References) -> list[Path]:
    """Finds the picture of each evaluated view in a folder with the pictures of another codec.

    A picture belongs to the view with the same name. If names differ, the folder must have one picture for each view of
    the scene, and both are matched in sorted order.

    Args:
        folder: Folder of PNG or JPEG files.
        references: The reference images of the scene.

    Raises:
        DatasetError: If the pictures fit the views neither by name nor by number.
    """
    # Numbered pictures (`00000.png`, as 3DGS and HAC++ write them) count all views of the scene.
    files = _files(folder)
    by_name = {file.stem: file for file in files}
    names = [Path(name).stem for name in references.names]
    if all(name in by_name for name in names):
        return [by_name[name] for name in names]
    if len(files) == references.num_views:
        return [files[index] for index in references.chosen]
    missing = next(name for name in names if name not in by_name)
    raise DatasetError(
        f"{folder}: has {len(files)} pictures and none of view '{missing}'; name them as the views, or give one for "
        f"each of the {references.num_views} views"
    )


def read_pictures(
    paths: Sequence[Path], height: int, width: int, background: Background
) -> Iterator[Float[np.ndarray, "H W 3"]]:
    """Reads pictures, RGB in [0, 1].

    Args:
        paths: The files.
        height: Height of the views in pixels.
        width: Width of the views in pixels.
        background: RGB visible where alpha is below 1.

    Raises:
        DatasetError: If a file is not a picture, or has another size than the views.
    """
    for path in paths:
        pixels = load_photo(path, background=background)
        _check_size(path, pixels.shape[1::-1], (width, height))
        yield pixels


def _check_size(path: Path, size: tuple[int, ...], expected: tuple[int, int]) -> None:
    """Checks the width and height of a picture in pixels."""
    if tuple(size) != expected:
        width, height = expected
        raise DatasetError(f"{path} has {size[0]} x {size[1]} pixels, and the views have {width} x {height}")


def _files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES)
