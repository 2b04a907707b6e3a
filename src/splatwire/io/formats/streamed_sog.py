"""Streamed SOG (PlayCanvas): a `lod-meta.json` with a tree of tiles, and SOG files (chunks) for each level of detail.

For each of its levels (0 is the finest), a leaf of the tree names a chunk and a range of Gaussians in this chunk. The
optional environment is one more SOG file with Gaussians outside the tree, such as the sky. The reader takes the finest
available level of each leaf, and the environment.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.kinds import SOG_LEVELS_NAME, SOG_META_NAME
from splatwire.files.read_limited import read_json
from splatwire.io.formats import sog
from splatwire.io.formats._asset import metadata_of_asset, origin_of_asset, warn_of_unused_extras
from splatwire.io.formats._columns import check_count, of_degree
from splatwire.io.formats._placement import warn_of_unused_fields
from splatwire.io.formats.content import FileContent
from splatwire.io.formats.sog import read_sog
from splatwire.types.splats import CHUNK_GAUSSIANS, Splats

LOG = logging.getLogger(__name__)
MAX_LEAVES = 1 << 16
MAX_CHUNKS = 1 << 14
_BUNDLE = ".sog"
_VERSIONS = (1,)
_NODE_FIELDS = ("bound", "children", "lods")


@dataclass(frozen=True)
class Piece:
    """A range of consecutive Gaussians in a chunk.

    Attributes:
        chunk: Index of the chunk's file in the file list.
        offset: Index of the first Gaussian.
        count: Number of Gaussians in the range.
    """

    chunk: int
    offset: int
    count: int


def read_streamed_sog(path: Path) -> FileContent:
    """Reads the Gaussians of a streamed SOG, using the finest available level of detail of each leaf.

    Args:
        path: Path of the `lod-meta.json`, or of its folder.

    Raises:
        DatasetError: If the file is damaged, contradicts its chunks, or no chunk is available.
        OSError: If a file cannot be read.
    """
    index = path / SOG_LEVELS_NAME if path.is_dir() else path
    content = read_json(index, DatasetError)
    if not isinstance(content, dict):
        raise DatasetError(f"{index}: is no JSON object")
    version = content.get("version", 1)
    if version not in _VERSIONS:
        LOG.warning("%s: version %.20r is not known: it is read as version %d", index, version, _VERSIONS[0])
    warn_of_unused_fields(index, {name: content[name] for name in content if name not in ("asset", "tree")})
    warn_of_unused_extras(index, content.get("asset"))
    chunks = _chunks(index, content)
    pieces, named, absent, coarser = _finest(index, content, chunks)
    if not pieces:
        raise DatasetError(f"{index}: none of the {len(chunks)} chunks that it names is here")
    if absent:
        LOG.warning("%s: %d of %d chunks are not here: %s", index, len(absent), len(chunks), ", ".join(absent[:8]))
    if coarser:
        LOG.warning("%s: %d leaves are read at a coarser level, or not at all, for lack of chunks", index, coarser)
    asset = sog.read_asset(chunks[min(pieces)])
    metadata = metadata_of_asset(content.get("asset"), index).over(metadata_of_asset(asset, index))
    stated = {sog.is_antialiased(chunks[number]) for number in pieces}
    if len(stated) > 1:
        LOG.warning("%s: some chunks ask for antialiasing, others do not: the scene is drawn with it", index)
    splats = _read_pieces(index, chunks, pieces, named)
    return FileContent(splats, origin_of_asset(asset, index), antialiased=any(stated), metadata=metadata)


def is_antialiased(path: Path) -> bool:
    """True if at least one SOG file (chunk) of a valid streamed SOG declares antialiasing."""
    index = path / SOG_LEVELS_NAME if path.is_dir() else path
    chunks_present = [
        chunk for chunk in dict.fromkeys(_chunks(index, read_json(index, DatasetError))) if _is_here(chunk)
    ]
    return any(sog.is_antialiased(chunk) for chunk in chunks_present)


def _chunks(index: Path, content: dict[str, Any]) -> list[Path]:
    """Returns the paths of the SOG files (chunks) of a streamed SOG.

    If the streamed SOG has an environment, the last path is that of the environment: a SOG file with Gaussians outside
    the tree, such as the sky.

    Args:
        index: Path of the `lod-meta.json`.
        content: Parsed content of the `lod-meta.json`.

    Raises:
        DatasetError: If a chunk is outside the folder of the index, or a name is invalid.
    """
    names, environment = content.get("filenames"), content.get("environment")
    if not isinstance(names, list) or not len(names) <= MAX_CHUNKS:
        raise DatasetError(f"{index}: filenames is no list of at most {MAX_CHUNKS:,} names")
    out = []
    for name in [*names, *([] if environment is None else [environment])]:
        pure = PurePosixPath(name) if isinstance(name, str) and "\0" not in name and len(name) < 256 else None
        is_known = pure is not None and (pure.name == SOG_META_NAME or pure.suffix.lower() == _BUNDLE)
        if pure is None or not is_known or pure.is_absolute() or ".." in pure.parts:
            raise DatasetError(
                f"{index}: {name!r:.60} names no {SOG_META_NAME} of a folder beside it, and no {_BUNDLE} file"
            )
        out.append(index.parent / (pure.parent if pure.name == SOG_META_NAME else pure))
    return out


def _is_here(chunk: Path) -> bool:
    return _file_of(chunk).is_file()


def _file_of(chunk: Path) -> Path:
    """Returns the path of the file to open for a chunk of a streamed SOG.

    If the chunk is a bundle, this is the chunk itself. If the chunk is a folder, this is its `meta.json`.
    """
    return chunk if chunk.suffix.lower() == _BUNDLE and not chunk.is_dir() else chunk / SOG_META_NAME


def _first_of_same(chunks: list[Path], exist: list[bool]) -> list[int]:
    """Finds chunks of a streamed SOG that are the same file, under different names or links.

    Args:
        chunks: Path of each chunk.
        exist: True for each chunk whose file exists.

    Returns:
        For each chunk, the index of the first chunk with the same file. The result for a chunk is its own index if no
        earlier chunk has the same file, or if the file is missing.
    """
    first: dict[tuple[int, int], int] = {}
    first_indices = []
    for number, (chunk, exists) in enumerate(zip(chunks, exist, strict=True)):
        if not exists:
            first_indices.append(number)
            continue
        status = _file_of(chunk).stat()
        first_indices.append(first.setdefault((status.st_dev, status.st_ino), number))
    return first_indices


def _finest(
    index: Path, content: dict[str, Any], chunks: list[Path]
) -> tuple[dict[int, list[Piece]], dict[int, list[Piece]], list[str], int]:
    """Selects the Gaussians to read: the finest available level of detail in each leaf of the tree.

    Args:
        index: Path of the `lod-meta.json`, for messages.
        content: Parsed content of the `lod-meta.json`.
        chunks: Paths of the chunks.

    Returns:
        Four values:

        * Ranges of Gaussians to read, by index of the chunk. The count -1 means all Gaussians of the chunk.
        * Ranges of all levels in the tree, by index of the chunk.
        * Names of missing chunks.
        * Number of leaves whose finest level is missing.
    """
    exist = [_is_here(chunk) for chunk in chunks]
    same = _first_of_same(chunks, exist)
    pieces: dict[int, list[Piece]] = {}
    ranges: dict[int, list[Piece]] = {}
    coarser = 0
    named = len(chunks) - (content.get("environment") is not None)
    for levels in _leaves(index, content.get("tree")):
        numbered = sorted(((_level(index, name), level) for name, level in levels.items()), key=lambda item: item[0])
        if len(dict(numbered)) < len(numbered):
            raise DatasetError(f"{index}: a leaf of its tree names a level twice: {', '.join(levels)[:80]}")
        leaf_pieces = [_piece(index, level, named) for _, level in numbered]
        leaf_pieces = [replace(piece, chunk=same[piece.chunk]) for piece in leaf_pieces if piece.count]
        for piece in leaf_pieces:
            ranges.setdefault(piece.chunk, []).append(piece)
        best = next((piece for piece in leaf_pieces if exist[piece.chunk]), None)
        coarser += bool(leaf_pieces) and best is not leaf_pieces[0]
        if best is not None:
            pieces.setdefault(best.chunk, []).append(best)
    if named < len(chunks) and exist[named]:
        if same[named] in ranges:
            raise DatasetError(f"{index}: its environment, {chunks[named].name}, is a chunk of its tree, too")
        pieces[named] = [Piece(named, 0, -1)]
    return pieces, ranges, [chunks[n].name for n in range(len(chunks)) if not exist[n]], coarser


def _leaves(index: Path, tree: Any) -> Iterator[dict[str, Any]]:
    """Yields the levels of detail (`lods`, a JSON object) of each leaf of the tree in a file `lod-meta.json`."""
    waiting, count = [tree], 0
    unknown: set[str] = set()
    while waiting:
        node, count = waiting.pop(), count + 1
        if not isinstance(node, dict) or count > 2 * MAX_LEAVES:
            raise DatasetError(f"{index}: its tree has a node that is none, or more than {2 * MAX_LEAVES:,}")
        children, levels = node.get("children", []), node.get("lods", {})
        if not isinstance(children, list) or not isinstance(levels, dict):
            raise DatasetError(f"{index}: a node of its tree has children that are no list, or lods that are no object")
        if children and levels:
            raise DatasetError(f"{index}: a node of its tree has children and lods, so Gaussians may be there twice")
        unknown |= node.keys() - set(_NODE_FIELDS)
        waiting += reversed(children)
        if levels:
            yield levels
    if unknown:
        names = ", ".join(sorted(unknown))[:120]
        LOG.warning("%s: %s of nodes of its tree are not known: the scene may look different", index, names)


def _level(index: Path, name: str) -> int:
    if not name.isdecimal() or len(name) > 3:
        raise DatasetError(f"{index}: {name!r:.40} is no level")
    return int(name)


def _piece(index: Path, lod_level: Any, num_chunks: int) -> Piece:
    values = [lod_level.get(name) for name in ("file", "offset", "count")] if isinstance(lod_level, dict) else []
    numbers = [value for value in values if type(value) is int and 0 <= value < 1 << 31]
    if len(numbers) != 3 or numbers[0] >= num_chunks:
        raise DatasetError(f"{index}: a level is {lod_level!r:.80}, no run of a chunk that is named")
    return Piece(*numbers)


def _read_pieces(
    index: Path, chunks: list[Path], pieces: dict[int, list[Piece]], named: dict[int, list[Piece]]
) -> Splats:
    """Reads the selected ranges of Gaussians from all chunks, and concatenates them.

    Args:
        index: Path of the `lod-meta.json`, for messages.
        chunks: Paths of the chunks.
        pieces: Ranges to read, by index of the chunk.
        named: Ranges that leaves of the tree use at any level of detail, by index of the chunk. Gaussians outside these
            ranges cause a warning.
    """
    unnamed = 0
    whole_ones = {n: read_sog(chunks[n]).splats for n, runs in pieces.items() if runs[0].count < 0}
    counts = {n: sum(run.count for run in runs) for n, runs in pieces.items()}
    counts |= {n: part.num_gaussians for n, part in whole_ones.items()}
    total, offset = check_count(index, sum(counts.values()), sum(sog.stored_bytes(chunks[n]) for n in pieces)), 0
    joined: Splats | None = None
    for chunk, runs in sorted(pieces.items()):
        part = whole_ones.pop(chunk, None)
        if part is None:
            part, more = _read_chunk(index, chunks[chunk], runs, named[chunk])
            unnamed += more
        if joined is None or part.degree > joined.degree:
            joined = _with_capacity(joined, offset, total, part.degree)
        # Missing harmonics are 0, so that chunks of a lower degree are unchanged.
        joined.fill(offset, of_degree(part, joined.degree))
        offset += part.num_gaussians
    assert joined is not None
    if unnamed:
        LOG.warning(
            "%s: its chunks have %s Gaussians that no leaf of the tree names: they are left out", index, f"{unnamed:,}"
        )
    return joined


def _with_capacity(joined: Splats | None, count: int, total: int, degree: int) -> Splats:
    """Returns larger arrays for the Gaussians of a scene, with a copy of the Gaussians read so far.

    Args:
        joined: Arrays of the Gaussians that were read so far; None for the first allocation.
        count: Number of Gaussians to copy.
        total: Number of Gaussians that the new arrays can hold.
        degree: Degree of the spherical harmonics in the new arrays, not below that of `joined`.
    """
    room = Splats.empty(total, degree)
    for begin in range(0, 0 if joined is None else count, CHUNK_GAUSSIANS):
        assert joined is not None
        room.fill(begin, of_degree(joined.slice_range(begin, min(begin + CHUNK_GAUSSIANS, count)), degree))
    return room


def _read_chunk(index: Path, folder: Path, runs: list[Piece], named: list[Piece]) -> tuple[Splats, int]:
    """Reads some ranges of Gaussians from one SOG file (chunk) of a streamed SOG.

    Args:
        index: Path of the `lod-meta.json`, for messages.
        folder: Path of the chunk.
        runs: Ranges to read, which must not overlap.
        named: Ranges of this chunk used by leaves of the level-of-detail tree. Ranges of all levels of detail are
            included.

    Returns:
        The Gaussians in `runs`; and the number of the chunk's Gaussians that no leaf uses.

    Raises:
        DatasetError: If ranges overlap or end after the chunk.
    """
    splats = read_sog(folder).splats
    taken = np.zeros(splats.num_gaussians, np.bool_)
    for run in runs:
        selection = slice(run.offset, run.offset + run.count)
        if selection.stop > len(taken) or bool(taken[selection].any()):
            which = f"Gaussians {run.offset:,} to {selection.stop:,} of {folder.name}"
            raise DatasetError(f"{index}: {which}, which has {len(taken):,}, are not there or belong to two leaves")
        taken[selection] = True
    taken_before = taken.copy()
    for run in named:
        taken_before[run.offset : run.offset + run.count] = True
    return splats.select(taken), int((~taken_before).sum())
