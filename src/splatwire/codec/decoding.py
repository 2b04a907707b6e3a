"""Stream to scene, whatever schema its anchors are coded with: takes bytes and nothing else."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.codec.schema import AnchorDecoder, chunks, update_digest
from splatwire.codec.schemas.causal.decoder import CausalDecoder
from splatwire.codec.schemas.hacpp.decoder import HacppDecoder, decode_separated
from splatwire.codec.threads import ordered_map
from splatwire.codec.tier_sizes import read_tier_sizes
from splatwire.codec.tiers import read_tiers
from splatwire.errors import BitstreamError, DesyncError
from splatwire.model import PartialScene
from splatwire.packets import CAUSAL, GAUSSIANS, Manifest, SceneStream, arrange, tier_order


def decode_anchors(
    stream: SceneStream, *, threads: int | None = None, progress: Callable[[float], None] | None = None
) -> PartialScene:
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
    scene, digest = decode(stream, threads, progress)
    if len(stream.packets) == manifest.num_packets and digest != manifest.symbols_digest:
        raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
    return scene


def open_decoder(manifest: Manifest, side_info: bytes) -> AnchorDecoder:
    """Reads the side information of a stream whose packets hold whole anchors.

    Raises:
        MissingSideInfoError: If there is none.
        BitstreamError: If it is damaged, contradicts the manifest, or tells of packets that cannot be decoded.
    """
    _check_anchors(manifest)
    if manifest.packetization.separated:
        raise BitstreamError("packets of separated attributes are decoded all at once, not one by one")
    kind = CausalDecoder if manifest.codec == CAUSAL else HacppDecoder
    return kind(manifest, side_info)


@dataclass(frozen=True, eq=False)
class TierFacts:
    """What tiers say of a stream's anchors.

    Attributes:
        order: Rank at each place of the manifest's plan, int64 (N); None if they are the same: there is one tier.
        sizes: See `PartialScene.tier_sizes`.
    """

    order: np.ndarray | None
    sizes: Float[Tensor, "N"] | None


def tier_facts(decoder: AnchorDecoder, manifest: Manifest) -> TierFacts:
    """Reads what a stream says of its tiers.

    Raises:
        BitstreamError: If side information and manifest contradict each other.
    """
    tiers, sizes = read_tiers(decoder.sections, manifest), read_tier_sizes(decoder.sections, manifest)
    order = tier_order(tiers) if manifest.tiers else None
    return TierFacts(order, None if sizes is None else torch.from_numpy(sizes[tiers]))


def _check_anchors(manifest: Manifest) -> None:
    if manifest.codec == GAUSSIANS:
        raise BitstreamError("the stream holds explicit Gaussians, not anchors: `decode -o FILE.ply` reads it")


def _decode_atomic(
    stream: SceneStream, threads: int | None, progress: Callable[[float], None] | None
) -> tuple[PartialScene, str]:
    decoder = open_decoder(stream.manifest, stream.side_info)
    groups, packets = arrange(stream.manifest.plan, stream.packets)
    tiers = tier_facts(decoder, stream.manifest)
    rank_at = groups.ranks if tiers.order is None else tiers.order[groups.ranks]
    counts, digest = np.diff(groups.starts), hashlib.sha256()

    def decode_run(run: slice) -> tuple[slice, np.ndarray | None]:
        ranks = rank_at[groups.starts[run.start] : groups.starts[run.stop]]
        decoder.predict(ranks)
        here = packets[run]
        there = np.array([packet is not None for packet in here])
        if not there.any():
            return run, None
        ranks = ranks[np.repeat(there, counts[run])]
        payloads = [packet.payload for packet in here if packet is not None]
        rows = decoder.decode(ranks, counts[run][there], payloads)
        decoder.store(ranks, rows)
        return run, rows

    for run, rows in ordered_map(decode_run, chunks(counts), threads):
        if rows is not None:
            update_digest(digest, rows)
        if progress:
            progress(run.stop / len(counts))
    return replace(decoder.scene(), tier_sizes=tiers.sizes), digest.hexdigest()
