"""Stream to scene, whatever its elements are: takes bytes and nothing else."""

import hashlib
from collections.abc import Callable, Iterable, Iterator

from splatwire.codec.background import read_background
from splatwire.codec.memory import allocating, threads_within
from splatwire.codec.registry import schema_named
from splatwire.codec.schema import CHUNK, Decoder, Rows, Run
from splatwire.codec.threads import ordered_map
from splatwire.codec.viewpoint import check_viewpoint
from splatwire.errors import DesyncError, check_kind
from splatwire.model.partial import Partial
from splatwire.packets import Manifest, Packet, SceneStream, arrived_blocks
from splatwire.packets.sections import split_sections


def decode_stream(
    stream: SceneStream, *, threads: int | None = None, progress: Callable[[float], None] | None = None
) -> Partial:
    """Decodes what arrived of a stream.

    Args:
        stream: The stream; packets may be missing, side information may not.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The scene and what of it is there, and all that the stream says of its elements: anchors by rank with the prior
        of each, or explicit Gaussians by place. Of a feature that arrived in part, the channels before the first
        missing group are there, though it counts as not received.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If the stream contradicts itself.
        InvalidValueError: If `stream` is none.
        DesyncError: If nothing was lost and yet the decoded integers are not those that were encoded.
    """
    check_kind(stream, SceneStream, "read_stream")
    manifest, digest = stream.manifest, hashlib.sha256()
    what = f"decoding {manifest.num_elements:,} {manifest.elements}"
    complete = len(stream.packets) == manifest.num_packets
    with allocating(what):
        decoder = open_decoder(manifest, stream.side_info, stream.num_bytes)
        working = decoder.working_bytes(stream.packets)
        threads = threads_within(decoder.scene_bytes, working, stream.num_bytes, what, threads)
        decoder.expect(threads)

        def decode_run(run: Run) -> tuple[int, Rows | None]:
            rows = decoder.decode(run)
            decoder.store(run, rows)
            return len(run.packets), rows if complete else None

        done, runs = 0, runs_of(decoder, manifest, stream.packets, gaps=True)
        for count, rows in ordered_map(decode_run, runs, threads):
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
    """Reads the side information of a stream.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        num_bytes: Bytes of the stream that are there; None for those of the side information alone.

    Raises:
        MissingSideInfoError: If there is none.
        BitstreamError: If it is damaged or contradicts the manifest.
    """
    schema = schema_named(manifest.codec)
    decoder = schema.open_decoder(manifest, side_info, len(side_info) if num_bytes is None else num_bytes)
    sections = split_sections(side_info, manifest.codec)[1]
    read_background(sections)
    check_viewpoint(sections)
    return decoder


def runs_of(decoder: Decoder, manifest: Manifest, packets: Iterable[Packet], *, gaps: bool = False) -> Iterator[Run]:
    """Packets that are decoded together, in the order of the plan.

    Args:
        decoder: Says how they are cut.
        manifest: The stream's manifest.
        packets: What arrived, in any order.
        gaps: Whether blocks of which nothing arrived are runs, too, where a run is a block.

    Raises:
        InvalidValueError: If a packet does not fit the plan, or two hold the same element.
    """
    waiting: list[Run] = []
    total = 0
    for block in arrived_blocks(manifest.plan, packets, gaps=gaps and decoder.whole_blocks):
        ranks = block.ranks if decoder.order is None else decoder.order[block.ranks]
        members = tuple(ranks[own] for own in block.runs)
        if decoder.whole_blocks:
            yield Run(block.number, block.packets, members)
            continue
        for packet, own in zip(block.packets, members, strict=True):
            if waiting and total + packet.num_elements > CHUNK:
                yield _joined(waiting)
                waiting, total = [], 0
            waiting.append(Run(block.number, (packet,), (own,)))
            total += packet.num_elements
    if waiting:
        yield _joined(waiting)


def _joined(runs: list[Run]) -> Run:
    packets = tuple(packet for run in runs for packet in run.packets)
    return Run(runs[0].block, packets, tuple(own for run in runs for own in run.members))
