"""Decodes streams to scenes, for all kinds of scenes."""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from splatwire.arguments import check_threads, checked_except
from splatwire.bitstream import Manifest, Packet, SceneStream, arrived_blocks
from splatwire.bitstream.sections import split_sections
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.initial_view import check_view_sections
from splatwire.codec.memory import allocating, threads_within
from splatwire.codec.registry import schema_named
from splatwire.codec.schema import CHUNK, DecodedRows, Decoder, PacketBatch
from splatwire.codec.threads import ordered_map
from splatwire.errors import DesyncError, check_kind, check_progress
from splatwire.types.received_scene import ReceivedScene


@checked_except("progress", "threads", "stream")
def decode_stream(
    stream: SceneStream, *, threads: int | None = None, progress: Callable[[float], None] | None = None
) -> ReceivedScene:
    """Decodes the received packets of a stream.

    Args:
        stream: The stream. Packets may be missing; the side information must be present.
        threads: Number of threads, which does not affect the result; None for one per processor.
        progress: Called with the completed fraction of the work, 0 to 1.

    Returns:
        The scene (anchors in coding order, Gaussians in plan order), the mask of received elements, and the stream's
        metadata. Anchors also have values predicted from the side information (`Prior`).

    Raises:
        MissingSideInfoError: If the stream has no side information.
        BitstreamError: If the stream contradicts itself.
        InvalidValueError: If `stream` is not a stream.
        DesyncError: If no packet is missing, but the decoded integers differ from the encoded ones.
    """
    check_kind(stream, SceneStream, "read_stream")
    check_progress(progress)
    check_threads(threads)
    manifest, digest = stream.manifest, hashlib.sha256()
    activity = f"decoding {manifest.num_elements:,} {manifest.elements}"
    complete = len(stream.packets) == manifest.num_packets
    with allocating(activity):
        decoder = open_decoder(manifest, stream.side_info, stream.num_bytes)
        working = decoder.working_bytes(stream.packets)
        threads = threads_within(decoder.scene_bytes, working, stream.num_bytes, activity, threads)
        decoder.allocate(threads)

        def decode_batch(batch: PacketBatch) -> tuple[int, DecodedRows | None]:
            rows = decoder.decode(batch)
            decoder.store(batch, rows)
            return len(batch.packets), rows if complete else None

        done, batches = 0, batches_of(decoder, manifest, stream.packets, gaps=True)
        for count, rows in ordered_map(decode_batch, batches, threads):
            done += count
            if rows is not None:
                decoder.update_digest(digest, rows)
            if progress:
                progress(done / max(len(stream.packets), 1))
        scene = decoder.scene()
    if complete and digest.hexdigest() != manifest.symbols_digest:
        raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
    return scene


def open_decoder(manifest: Manifest, side_info: bytes, num_bytes: int | None = None) -> Decoder:
    """Reads the side information of a stream and creates the decoder for its schema.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        num_bytes: Bytes received of the stream, for memory limits; None for the size of the side information.

    Raises:
        MissingSideInfoError: If the side information is missing.
        BitstreamError: If the side information is damaged or contradicts the manifest.
    """
    schema = schema_named(manifest.schema_name)
    decoder = schema.open_decoder(manifest, side_info, len(side_info) if num_bytes is None else num_bytes)
    sections = split_sections(side_info, manifest.schema_name)[1]
    BACKGROUND_SECTION.read(sections)  # raises if it is damaged; decoders read the value in `scene`
    check_view_sections(sections)
    return decoder


def batches_of(
    decoder: Decoder, manifest: Manifest, packets: Iterable[Packet], *, gaps: bool = False
) -> Iterator[PacketBatch]:
    """Divides received packets into batches (packets that a decoder decodes in one call), and yields them in order.

    Args:
        decoder: The stream's decoder, which determines the size of batches.
        manifest: The stream's manifest.
        packets: Received packets, in any order.
        gaps: True to also yield an empty batch for each lost block, if the decoder decodes whole blocks.

    Raises:
        InvalidValueError: If a packet does not fit the stream's packet plan, or two packets contain the same element.
    """
    waiting: list[PacketBatch] = []
    total = 0
    for batch in arrived_blocks(manifest.plan, packets, gaps=gaps and decoder.batches_are_blocks):
        if decoder.order is not None:
            batch = replace(batch, members=tuple(decoder.order[indices] for indices in batch.members))
        if decoder.batches_are_blocks:
            yield batch
            continue
        for packet, indices in zip(batch.packets, batch.members, strict=True):
            if waiting and total + packet.num_elements > CHUNK:
                yield _joined(waiting)
                waiting, total = [], 0
            waiting.append(PacketBatch(batch.block, (packet,), (indices,)))
            total += packet.num_elements
    if waiting:
        yield _joined(waiting)


def _joined(batches: list[PacketBatch]) -> PacketBatch:
    packets = tuple(packet for batch in batches for packet in batch.packets)
    return PacketBatch(batches[0].block, packets, tuple(indices for batch in batches for indices in batch.members))
