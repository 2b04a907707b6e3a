"""Finds COLMAP reconstructions in a dataset folder by the names of their files."""

from pathlib import Path

SUFFIXES = ("bin", "txt")
"""Suffixes of the files of a reconstruction, the preferred one first."""
_MAX_DIGITS = 20


def has_table(folder: Path, table: str) -> bool:
    """True if a folder contains a file of a reconstruction, binary or text.

    Args:
        folder: The folder.
        table: Name of the file without suffix: `cameras`, `images` or `points3D`.
    """
    return any((folder / f"{table}.{suffix}").is_file() for suffix in SUFFIXES)


def reconstructions(root: Path) -> list[Path]:
    """Returns the folders in a dataset that contain a COLMAP reconstruction, the preferred one first.

    The order is: `sparse/0`, `sparse`, `colmap/sparse/0`, `root` itself, then the numbered folders in `sparse`, in
    `colmap/sparse` and in `root`, in ascending order of their numbers. A folder that is reached by two of these paths,
    for example by a link, is listed once.

    Args:
        root: Folder of the dataset.

    Raises:
        OSError: If a folder cannot be listed.
    """
    found = [folder for name in ("sparse/0", "sparse", "colmap/sparse/0") if has_table(folder := root / name, "images")]
    if has_table(root, "images") and has_table(root, "cameras"):  # layout of RealityScan exports
        found.append(root)
    for name in ("sparse", "colmap/sparse", ""):  # the last one for `colmap mapper --output_path ROOT`
        found += [folder for folder in _numbered_folders(root / name) if has_table(folder, "images")]
    distinct: dict[Path, Path] = {}
    for folder in found:
        distinct.setdefault(folder.resolve(), folder)
    return list(distinct.values())


def _numbered_folders(folder: Path) -> list[Path]:
    """Returns the subfolders of `folder` whose names are numbers, in ascending order of the numbers."""
    folders = [path for path in folder.iterdir() if path.name.isdecimal()] if folder.is_dir() else []
    return sorted(folders, key=lambda path: int(path.name[:_MAX_DIGITS]))
