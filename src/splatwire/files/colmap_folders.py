"""Finds COLMAP reconstructions in a dataset folder by the names of their files."""

from collections.abc import Iterator
from pathlib import Path

SUFFIXES = ("bin", "txt")
"""Suffixes of the files of a reconstruction, the preferred one first."""
_MAX_DIGITS = 20
"""Number of digits of a folder's name that determine its place in the order; a name may have hundreds."""


def has_table(folder: Path, table: str) -> bool:
    """True if a folder contains a file of a reconstruction, binary or text.

    Args:
        folder: The folder.
        table: Name of the file without suffix: `cameras`, `images` or `points3D`.
    """
    return any((folder / f"{table}.{suffix}").is_file() for suffix in SUFFIXES)


def reconstructions(root: Path) -> Iterator[Path]:
    """Yields the folders in a dataset that contain a COLMAP reconstruction, the preferred one first.

    The order is: `sparse/0`, `sparse`, `colmap/sparse/0`, `root` itself, then the numbered folders in `sparse`, in
    `colmap/sparse` and in `root`, in ascending order of their numbers. A folder that is reached by two of these paths,
    for example by a link, is yielded once. The first reconstruction is found even if a later folder cannot be listed.

    Args:
        root: Folder of the dataset.

    Raises:
        OSError: If a folder cannot be listed.
    """
    found = set[Path]()
    for folder in _candidates(root):
        if (real := folder.resolve()) not in found:
            found.add(real)
            yield folder


def _candidates(root: Path) -> Iterator[Path]:
    named = (root / name for name in ("sparse/0", "sparse", "colmap/sparse/0"))
    yield from (folder for folder in named if has_table(folder, "images"))
    if has_table(root, "images") and has_table(root, "cameras"):  # layout of RealityScan exports
        yield root
    for name in ("sparse", "colmap/sparse", ""):  # the last one for `colmap mapper --output_path ROOT`
        yield from (folder for folder in _numbered_folders(root / name) if has_table(folder, "images"))


def _numbered_folders(folder: Path) -> list[Path]:
    """Returns the subfolders of `folder` whose names are numbers, in ascending order of the numbers."""
    folders = [path for path in folder.iterdir() if path.name.isdecimal()] if folder.is_dir() else []
    return sorted(folders, key=lambda path: int(path.name[:_MAX_DIGITS]))
