"""Copies of some Gaussians of a stream in its side information, for where their packets are lost (docs/format.md)."""

from dataclasses import replace

import numpy as np

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.codec.schemas.gaussians.attributes import empty_rows, to_splats
from splatwire.codec.schemas.gaussians.side_info import SideInfo, read_blocks
from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.model import Copies
from splatwire.packets.limits import MAX_COPIES

SECTION = "sketch"
VERSION = 1
GROWTH_UNIT = 64
"""Numbers of the growth are out of this."""


def write_places(places: np.ndarray, num_gaussians: int) -> bytes:
    """Places of Gaussians, each in as many bits as the last one takes, the high ones first."""
    width = _place_bits(num_gaussians)
    return np.packbits(places[:, None] >> np.arange(width)[::-1] & 1).tobytes()


def _read_places(reader: ByteReader, count: int, num_gaussians: int) -> np.ndarray:
    width = _place_bits(num_gaussians)
    bits = np.unpackbits(np.frombuffer(reader.take((count * width + 7) // 8), np.uint8), count=count * width)
    places = bits.reshape(count, width).astype(np.int64) @ (1 << np.arange(width)[::-1])
    if places.max() >= num_gaussians or len(np.unique(places)) < count:
        raise BitstreamError("section 'sketch': places of copies are not those of different Gaussians")
    return places


def _place_bits(num_gaussians: int) -> int:
    return max((num_gaussians - 1).bit_length(), 1)


def write_head(growth: tuple[float, float, float], count: int, blocks: bytes) -> bytes:
    """What a section begins with, up to the places."""
    writer = ByteWriter()
    writer.u8(VERSION)
    for value in growth:
        writer.u8(min(max(round(value * GROWTH_UNIT), 0), 255))
    writer.unsigned(count)
    writer.blob(blocks)
    return writer.bytes()


def read_copies(info: SideInfo, num_gaussians: int) -> Copies | None:
    """Reads the copies in a stream's side information; None if there are none.

    Args:
        info: The side information.
        num_gaussians: Gaussians of the stream.

    Raises:
        UnsupportedVersionError: If a newer release wrote the section.
        BitstreamError: If it is damaged or of another stream.
    """
    if SECTION not in info.sections:
        return None
    reader = ByteReader(info.sections[SECTION], f"section '{SECTION}'")
    version = reader.u8()
    if version != VERSION:
        raise UnsupportedVersionError(f"section '{SECTION}' has version {version}, this release reads {VERSION}")
    size, opacity, trust = (reader.u8() / GROWTH_UNIT for _ in range(3))
    count = reader.unsigned()
    if not 1 <= count <= min(num_gaussians, MAX_COPIES):
        raise BitstreamError(f"section '{SECTION}': {count} copies of {num_gaussians} Gaussians are impossible")
    boxes, defaults = read_blocks(reader.blob(), 1)
    places = _read_places(reader, count, num_gaussians)
    here = replace(info, boxes=boxes, defaults=defaults)
    rows, harmonics = _decode(here, count, reader.rest())
    origins = np.broadcast_to(boxes.corners[0], (count, 3))
    splats = to_splats(rows, harmonics, origins, info.unit, info.size_log, info.transform)
    return Copies(places, splats, (size, opacity, trust))


def moved_copies(section: bytes, place_at: np.ndarray) -> bytes:
    """The section for a stream of the same tables in which Gaussians have other places.

    Args:
        section: The section.
        place_at: int64 (N), where each Gaussian of the stream is in the other one.
    """
    reader = ByteReader(section, f"section '{SECTION}'")
    head, count, blocks = reader.take(4), reader.unsigned(), reader.blob()
    places, writer = _read_places(reader, count, len(place_at)), ByteWriter()
    writer.unsigned(count)
    writer.blob(blocks)
    return bytes(head) + writer.bytes() + write_places(place_at[places], len(place_at)) + bytes(reader.rest())


def _decode(info: SideInfo, count: int, payload: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Decodes the only packet of the only block; any bytes decode to something."""
    from splatwire.codec.schemas.gaussians import _packet_kernels as kernels

    rows, harmonics = empty_rows(count, info.num_harmonics)
    data, ends = np.frombuffer(payload, dtype=np.uint8).copy(), np.array([0, len(payload)], dtype=np.int64)
    kernels.decode_packets(
        info.kernel_tables(), info.kernel_stream(), info.models(), data, ends, np.array([0, count], dtype=np.int64),
        info.boxes.bits, info.block_defaults, rows, harmonics,
    )  # fmt: skip
    return rows, harmonics
