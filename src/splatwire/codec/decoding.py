"""Stream to scene, whatever schema its anchors are coded with: takes bytes and nothing else."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from splatwire.codec.memory import allocating, threads_within
from splatwire.codec.schema import CHUNK_ANCHORS, AnchorDecoder, most_at_once, update_digest
from splatwire.codec.schemas.causal.decoder import CausalDecoder
from splatwire.codec.schemas.hacpp.decoder import HacppDecoder, decode_separated
from splatwire.codec.threads import ordered_map
from splatwire.codec.tier_sizes import read_tier_sizes
from splatwire.codec.tiers import read_tiers
from splatwire.errors import BitstreamError, DesyncError
from splatwire.model import AnchorScene, Partial, TierSizes
from splatwire.packets import CAUSAL, GAUSSIANS, Manifest, Packet, SceneStream, arrived_blocks, tier_order


def decode_anchors(
    stream: SceneStream, *, threads: int | None = None, progress: Callable[[float], None] | None = None
) -> Partial[AnchorScene]:
    """Decodes a stream of anchors, for those who work on their attributes; see `splatwire.codec.decode_stream`.

    Returns:
        The scene by rank, zero where nothing was received, and the prior of every anchor. Of a feature that
        arrived in part, the channels before the first missing group are there, though it counts as not received.

    Raises:
        BitstreamError: If the stream holds something else, too.
    """
    manifest = stream.manifest
    _check_anchors(manifest)
    decode = decode_separated if manifest.packetization.separated else _decode_atomic
    with allocating(f"decoding {manifest.num_anchors:,} anchors"):
        scene, digest = decode(stream, threads, progress)
    if len(stream.packets) == manifest.num_packets and digest != manifest.symbols_digest:
        raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
    return scene


def open_decoder(manifest: Manifest, side_info: bytes, num_bytes: int | None = None) -> AnchorDecoder:
    """Reads the side information of a stream whose packets hold whole anchors.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        num_bytes: Bytes of the stream that are there; None for those of the side information alone.

    Raises:
        MissingSideInfoError: If there is none.
        BitstreamError: If it is damaged, contradicts the manifest, or tells of packets that cannot be decoded.
    """
    _check_anchors(manifest)
    if manifest.packetization.separated:
        raise BitstreamError("packets of separated attributes are decoded all at once, not one by one")
    kind = CausalDecoder if manifest.codec == CAUSAL else HacppDecoder
    return kind(manifest, side_info, len(side_info) if num_bytes is None else num_bytes)


@dataclass(frozen=True, eq=False)
class TierFacts:
    """What tiers say of a stream's anchors.

    Attributes:
        order: Rank at each place of the manifest's plan, int64 (N); None if they are the same: there is one tier.
        said: `TierSizes`, where the stream says them.
    """

    order: np.ndarray | None
    said: tuple[TierSizes, ...]


def tier_facts(decoder: AnchorDecoder, manifest: Manifest) -> TierFacts:
    """Reads what a stream says of its tiers.

    Raises:
        BitstreamError: If side information and manifest contradict each other.
    """
    tiers, sizes = read_tiers(decoder.sections, manifest), read_tier_sizes(decoder.sections, manifest)
    order = tier_order(tiers) if manifest.tiers else None
    return TierFacts(order, () if sizes is None else (TierSizes(torch.from_numpy(sizes[tiers])),))


def _check_anchors(manifest: Manifest) -> None:
    if manifest.codec == GAUSSIANS:
        raise BitstreamError("the stream holds explicit Gaussians, not anchors: `decode -o FILE.ply` reads it")


def _decode_atomic(
    stream: SceneStream, threads: int | None, progress: Callable[[float], None] | None
) -> tuple[Partial[AnchorScene], str]:
    manifest, num = stream.manifest, stream.manifest.num_anchors
    decoder = open_decoder(manifest, stream.side_info, stream.num_bytes)
    working = most_at_once(stream.packets) * decoder.row_bytes
    threads = threads_within(decoder.scene_bytes, working, stream.num_bytes, f"decoding {num:,} anchors", threads)
    tiers, digest = tier_facts(decoder, manifest), hashlib.sha256()
    predict_all(decoder, num, threads)

    def decode_run(run: Sequence[tuple[np.ndarray, Packet]]) -> np.ndarray:
        ranks = np.concatenate([ranks for ranks, _ in run])
        counts = np.array([packet.num_anchors for _, packet in run], dtype=np.int64)
        rows = decoder.decode(ranks, counts, [packet.payload for _, packet in run])
        decoder.store(ranks, rows)
        return rows

    done = 0
    for rows in ordered_map(decode_run, _runs(stream, tiers.order), threads):
        update_digest(digest, rows)
        done += len(rows)
        if progress:
            progress(done / num)
    return decoder.scene().saying(*tiers.said), digest.hexdigest()


def predict_all(
    decoder: AnchorDecoder, num_anchors: int, threads: int | None, progress: Callable[[float], None] | None = None
) -> None:
    """Makes room for all anchors and evaluates what is expected of each."""
    decoder.make_room()

    def predict(start: int) -> int:
        ranks = np.arange(start, min(start + CHUNK_ANCHORS, num_anchors))
        decoder.predict(ranks)
        return int(ranks[-1]) + 1

    for done in ordered_map(predict, range(0, num_anchors, CHUNK_ANCHORS), threads):
        if progress:
            progress(done / num_anchors)


def _runs(stream: SceneStream, order: np.ndarray | None) -> Iterator[list[tuple[np.ndarray, Packet]]]:
    """Packets with the ranks of their anchors, in the order of the plan, some thousand anchors at a time."""
    run: list[tuple[np.ndarray, Packet]] = []
    total = 0
    for block in arrived_blocks(stream.manifest.plan, stream.packets):
        ranks = block.ranks if order is None else order[block.ranks]
        for packet, own in zip(block.packets, block.runs, strict=True):
            if run and total + packet.num_anchors > CHUNK_ANCHORS:
                yield run
                run, total = [], 0
            run.append((ranks[own], packet))
            total += packet.num_anchors
    if run:
        yield run
