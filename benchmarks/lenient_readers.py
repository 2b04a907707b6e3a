"""Repair of damaged files, as a lenient reader could do; for `other_formats_under_loss.py`.

Each function repairs a damaged file to a smaller valid one for the strict readers of splatwire. None of them invents
content: rows that were cut are left out, columns that were cut are zeros, broken members are kept as they are.
"""

import gzip
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np

_PIECE = 64
_LOCAL, _LOCAL_HEADER = b"PK\x03\x04", struct.Struct("<4s5H3I2H")
_CHUNK_ROWS = 256
_END = b"end_header\n"


def _ply_rows(data: bytes) -> tuple[bytes, dict[bytes, tuple[int, int, int]]] | None:
    """Header of a PLY; and for each element, the position of its rows in the file, their number, and bytes per row."""
    head, found, _ = data.partition(_END)
    elements = re.findall(rb"element (\w+) (\d+)\n((?:property \w+ \w+\n)*)", head)
    if not found or not elements:
        return None
    sections, at = {}, len(head) + len(_END)
    for name, count, properties in elements:
        size = sum(1 if b"char" in line else 4 for line in properties.splitlines())
        sections[name] = at, int(count), size
        at += int(count) * size
    return head, sections


def repair_ply(data: bytes, target: Path) -> bool:
    """Keeps whole rows of a binary PLY, explicit or compressed; returns False without rows."""
    found = _ply_rows(data)
    if found is None:
        return False
    head, sections = found
    whole = min((len(data) - start) // size for name, (start, _, size) in sections.items() if name != b"chunk")
    kept, parts = max(0, min(whole, sections[b"vertex"][1])), []
    for name, (start, _, size) in sections.items():
        rows = -(-kept // _CHUNK_ROWS) if name == b"chunk" else kept
        head = re.sub(rb"element %s \d+" % name, b"element %s %d" % (name, rows), head)
        parts.append(data[start : start + rows * size])
    target.write_bytes(head + _END + b"".join(parts))
    return kept > 0


def known_rows(whole: bytes, known: np.ndarray) -> np.ndarray | None:
    """Mask of completely received rows of a PLY, bool (N); None if its header is incomplete.

    Args:
        whole: The complete file.
        known: Mask of the received bytes, bool.
    """
    found = _ply_rows(whole)
    assert found is not None
    head, sections = found
    if not known[: len(head) + len(_END)].all():
        return None
    rows = np.ones(sections[b"vertex"][1], bool)
    for name, (start, count, size) in sections.items():
        arrived = known[start : start + count * size].reshape(count, size).all(axis=1)
        rows &= np.repeat(arrived, _CHUNK_ROWS)[: len(rows)] if name == b"chunk" else arrived
    return rows


def repair_spz(data: bytes, target: Path) -> bool:
    """Decompresses an SPZ of version 2 or 3 as far as possible; missing values of columns become zeros."""
    unpacker, content = zlib.decompressobj(31), bytearray()
    try:
        for start in range(0, len(data), _PIECE):
            content += unpacker.decompress(data[start : start + _PIECE])
    except zlib.error:
        pass
    if len(content) < 16:
        return False
    _, version, count, degree = struct.unpack_from("<4sIIB", content)
    row = 9 + 1 + 3 + 3 + (3 if version == 2 else 4) + 3 * ((degree + 1) ** 2 - 1)
    target.write_bytes(gzip.compress(bytes(content[: 16 + row * count]).ljust(16 + row * count, b"\0"), 1, mtime=0))
    return True


def repair_sog(data: bytes, target: Path) -> bool:
    """Unpacks a bundled SOG without verifying checksums, by its directory or else by the headers of its members."""
    target.mkdir(exist_ok=True)
    sections = _directory(data) or _local_headers(data)
    for name, (start, size) in sections.items():
        if re.fullmatch(r"[\w.]+", name) and start < len(data):
            (target / name).write_bytes(data[start : start + size])
    return (target / "meta.json").exists()


def _directory(data: bytes) -> dict[str, tuple[int, int]]:
    """Start and size of each stored member from the directory, if readable."""
    try:
        entries = zipfile.ZipFile(BytesIO(data)).infolist()
    except (zipfile.BadZipFile, ValueError, OSError, struct.error):
        return {}
    found = {}
    for entry in entries:
        header = data[entry.header_offset : entry.header_offset + _LOCAL_HEADER.size]
        extra = _LOCAL_HEADER.unpack(header)[-1] if header.startswith(_LOCAL) else 0
        start = entry.header_offset + _LOCAL_HEADER.size + len(entry.filename) + extra
        found[entry.filename] = start, entry.compress_size
    return found


def _local_headers(data: bytes) -> dict[str, tuple[int, int]]:
    """Start and size of each stored member, from the headers before the members."""
    found: dict[str, tuple[int, int]] = {}
    for match in re.finditer(re.escape(_LOCAL), data):
        header = data[match.start() : match.start() + _LOCAL_HEADER.size]
        if len(header) == _LOCAL_HEADER.size:
            *_, size, _, name_bytes, extra = _LOCAL_HEADER.unpack(header)
            name_at = match.start() + _LOCAL_HEADER.size
            name = data[name_at : name_at + name_bytes].decode("utf-8", "replace")
            found[name] = name_at + name_bytes + extra, size
    return found


REPAIRS: dict[str, Callable[[bytes, Path], bool]] = {
    "ply": repair_ply,
    "compressed.ply": repair_ply,
    "spz": repair_spz,
    "sog": repair_sog,
}


class HacppFiles:
    """The native files of a HAC++ model as one run of bytes, and the anchors that a loss leaves complete.

    Order, batches and chunks are those of HAC++'s layout: anchors in raster order, z slowest, 3,000 to a batch; a file
    for each batch and attribute; chunks of 10,000 symbols, each decoded from its first byte on. A symbol counts as
    read if its share of its chunk's bytes precedes the first gap of the chunk. No decoder can do better; the official
    one continues and reads noise. Networks count as received.

    Args:
        folder: The model's `bitstreams`.
        voxels: Positions as integers (N, 3).
        masks: Mask of existing offsets, bool (N, K).
    """

    SHARED = ("xyz_gpcc.npz", "x_bound_min.pkl", "x_bound_max.pkl", "masks.b", "hash.b")

    def __init__(self, folder: Path, voxels: np.ndarray, masks: np.ndarray) -> None:
        x, y, z = (voxels - voxels.min(axis=0)).T
        self._order = np.lexsort((x, y, z))
        masks, count = masks[self._order], len(masks)
        self._places: list[tuple[int, int]] = []
        self._readers: list[tuple[int, np.ndarray, np.ndarray, np.ndarray]] = []
        at = 0
        for name in self.SHARED:
            size = (folder / name).stat().st_size
            self._places.append((at, at + size))
            at += size
        self.shared_bytes = at
        for batch in range(-(-count // 3000)):
            rows = np.arange(3000 * batch, min(3000 * (batch + 1), count))
            symbols = {f"feat_{batch}_{group}_0.b": np.repeat(rows, 10) for group in range(5)}
            symbols[f"scaling_{batch}_0.b"] = np.repeat(rows, 6)
            symbols[f"offsets_{batch}_0.b"] = np.repeat(rows, 3 * masks[rows].sum(axis=1))
            for name, owners in symbols.items():
                data = (folder / name).read_bytes()
                at += self._add(at, data, owners)
        self.num_bytes = at

    def _add(self, at: int, data: bytes, owners: np.ndarray) -> int:
        """Records the position and meaning of each chunk of a file; returns the file's size."""
        chunks = -(-len(owners) // 10_000)
        counts = np.frombuffer(data, "<i4", chunks, 12)
        if 12 + 4 * chunks + int(counts.sum()) != len(data):
            raise ValueError("the file's chunks are not as long as its header says")
        starts = at + 12 + 4 * chunks + np.concatenate([[0], np.cumsum(counts)])
        self._readers.append((at, starts, owners, counts))
        return len(data)

    def whole(self, arrived: np.ndarray, packet: int, shared_given: bool) -> np.ndarray | None:
        """None if a common part is damaged."""
        known = np.repeat(arrived, packet)[: self.num_bytes]
        if not shared_given and not known[: self.shared_bytes].all():
            return None
        whole = np.ones(len(self._order), bool)
        for at, starts, owners, counts in self._readers:
            head = known[at : int(starts[0])].all()
            for chunk, size in enumerate(counts.tolist()):
                mine = owners[10_000 * chunk : 10_000 * (chunk + 1)]
                gaps = np.flatnonzero(~known[int(starts[chunk]) : int(starts[chunk]) + size])
                share = 0.0 if not head else 1.0 if not len(gaps) else gaps[0] / size
                whole[mine[int(share * len(mine)) :]] = False
        found = np.empty_like(whole)
        found[self._order] = whole
        return found
