"""Small streams that announce the largest content that their format allows."""

import hashlib
import itertools
import json
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.bitstream import (
    CAUSAL,
    GAUSSIANS,
    HACPP_ANCHORS,
    Manifest,
    PacketId,
    Packetization,
    SceneStream,
    make_packet,
)
from splatwire.bitstream.limits import TRACKS
from splatwire.bitstream.tiers import TierCounts
from splatwire.codec.anchors.causal.context import LOG_BITS
from splatwire.codec.anchors.causal.positions import AnchorPositions, CoarsePositions
from splatwire.codec.anchors.causal.side_info import SideInfo as CausalInfo
from splatwire.codec.anchors.causal.side_info import write_side_info as write_causal
from splatwire.codec.anchors.hacpp.side_info import MASK_CONTEXTS
from splatwire.codec.anchors.hacpp.side_info import SideInfo as HacppInfo
from splatwire.codec.anchors.hacpp.side_info import write_side_info as write_hacpp
from splatwire.codec.sequence.decoder import open_side_info as open_clip
from splatwire.codec.sequence.layout import ENDS, HEADER_FIELDS, MAX_TRACK_SPAN, MOVING, NUM_CHANNELS, STATE, TRACK
from splatwire.codec.sequence.motion_coder import MotionCoder
from splatwire.codec.sequence.side_info import Shot
from splatwire.codec.sequence.side_info import write_side_info as write_clip
from splatwire.codec.weight_bytes import framed
from splatwire.codec.weights import QuantisedLinear, QuantisedMlp
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.types import AnchorLayout
from splatwire.types.anchor_config import HacppConfig, HashGridConfig
from splatwire.types.causal_coding import CausalConfig
from splatwire.types.sequence_scene import Timeline

LARGEST = Packetization(block_size=65_535, lanes=1, grouping="contiguous")
SMALLEST = Packetization(block_size=1, lanes=256, grouping="contiguous")
CUT = Packetization(block_size=1 << 12, lanes=1, grouping="hashed", packet_bytes=1150)
"""Packed like clips."""
SEPARATED = Packetization(block_size=65_535, lanes=1, grouping="contiguous", packaging="separated")


def oversized_streams(gaussians: SceneStream) -> Iterator[tuple[str, SceneStream]]:
    """Creates streams of at most a megabyte.

    Args:
        gaussians: A small stream of explicit Gaussians with harmonics; its header and contexts are copied.
    """
    for blocks in (60, 4000):
        yield f"gaussians announced in {blocks} blocks", of_gaussians(gaussians, LARGEST, 65_535 * blocks, 0)
    yield "gaussians that arrive in no bytes", of_gaussians(gaussians, LARGEST, 65_535 * 4000, 4000)
    yield "a million gaussians that arrive", of_gaussians(gaussians, LARGEST, 65_535 * 16, 16)
    yield "gaussians alone in their blocks", of_gaussians(gaussians, SMALLEST, 5_000, 500)
    for bytes_ in (10_000, 800_000):
        for width, layout in (("narrow", AnchorLayout(1, 1, (1,))), ("wide", AnchorLayout(256, 64, (8,) * 32))):
            yield f"{8 * bytes_} {width} anchors", of_causal(layout, bytes_, 16, LARGEST, 0)
    usual = AnchorLayout(32, 10, (1, 1, 2, 4, 8, 16))
    yield "anchors that arrive in no bytes", of_causal(usual, 100_000, 32, LARGEST, 12)
    yield "anchors of the largest networks", of_causal(AnchorLayout(8, 4, (4, 4)), 10_000, 4096, LARGEST, 1)
    yield "anchors alone in their blocks", of_causal(AnchorLayout(1, 1, (1,)), 500_000, 8, SMALLEST, 500)
    for bytes_ in (10_000, 500_000):
        yield f"{8 * bytes_} anchors of format 1", of_hacpp(AnchorLayout(), bytes_, 32, LARGEST, 1)
    yield "wide anchors of format 1", of_hacpp(AnchorLayout(1024, 64, (16,) * 64), 20_000, 8, LARGEST, 2)
    yield "separated anchors", of_hacpp(AnchorLayout(), 500_000, 32, SEPARATED, 7)
    yield "separated anchors alone", of_hacpp(AnchorLayout(2, 1, (2,)), 5_000, 8, replace(SEPARATED, block_size=1), 99)
    yield "networks of format 1", of_hacpp(AnchorLayout(), 8_000, 1024, LARGEST, 1)


def oversized_clips(real: SceneStream) -> Iterator[tuple[str, SceneStream]]:
    """Clips of at most a megabyte; the tables are those of the small clip `real`."""
    for blocks in (30, 1600):
        yield f"{blocks} blocks of tracks announced", of_tracks(real, blocks, 64, bases=0, motion=0)
    yield "tracks that arrive in no bytes", of_tracks(real, 160, 64, bases=160, motion=0)
    yield "tracks that move in few bytes", of_tracks(real, 20, 64, bases=20, motion=19)
    yield "tracks that arrive and few of which move", of_tracks(real, 20, 64, bases=20, motion=1)
    yield "tracks that many packets speak of", of_tracks(real, 30, 64, bases=2, motion=29)


def of_tracks(real: SceneStream, blocks: int, frames: int, *, bases: int, motion: int) -> SceneStream:
    """Sequence of one group with tracks in several blocks, some of them without bytes, and motion packets."""
    info, num = open_clip(real.manifest, real.side_info), blocks * CUT.block_size
    base, none = info.keyframe_info, np.zeros((blocks, 3), np.int64)
    boxes = replace(base.boxes, shifts=none[:, 0], grid_corners=none, extents=none)
    base = replace(base, boxes=boxes, block_means=np.repeat(base.block_means[:1], blocks, axis=0))
    every = np.arange(MAX_TRACK_SPAN)
    coder = MotionCoder(
        *moving_rows(frames), every, first_new=0, max_payload_bytes=60_000, costs=np.ones(MAX_TRACK_SPAN)
    )
    zero_probabilities = coder.fit_zero_probabilities([(0, MAX_TRACK_SPAN)], 1)
    timeline = Timeline(info.timeline.rate, frames, frames)
    info = replace(
        info, timeline=timeline, shots=(Shot(0, 0, base),), zero_probabilities=zero_probabilities, sections={}
    )
    tiers, sizes = (TierCounts(num, 1), TierCounts(num, 1)), [CUT.block_size] * blocks
    stream = stream_of(TRACKS, CUT, 2 * num, write_clip(info), 0, tiers=tiers, packets=blocks + num // MAX_TRACK_SPAN)
    packets = [make_packet(PacketId(n, 0), size, b"", 7) for n, size in enumerate(sizes[:bases])]
    payloads = coder.encode(zero_probabilities, (0, MAX_TRACK_SPAN)).payloads
    for n in range(motion):
        block, begin = divmod(n * MAX_TRACK_SPAN, CUT.block_size)
        packets.append(make_packet(PacketId(blocks + block, begin), MAX_TRACK_SPAN, payloads[0], 7))
    return SceneStream(stream.manifest, stream.side_info, tuple(packets))


def moving_rows(frames: int) -> tuple[np.ndarray, ...]:
    """The maximum number of tracks per packet, all with the motion of the first, in every order."""
    heads = np.zeros((MAX_TRACK_SPAN, HEADER_FIELDS), np.int64)
    heads[:, TRACK], heads[:, STATE], heads[:, ENDS] = np.arange(MAX_TRACK_SPAN), MOVING, frames
    targets = np.zeros((MAX_TRACK_SPAN, NUM_CHANNELS, frames))
    targets[:, 0, frames - 1] = 1 << 12
    shifts = np.full((MAX_TRACK_SPAN, NUM_CHANNELS), 10, np.int64)
    return heads, np.zeros((MAX_TRACK_SPAN, 3), np.int64), shifts, targets


def of_gaussians(real: SceneStream, packetization: Packetization, num: int, num_packets: int) -> SceneStream:
    """Stream of Gaussians with the fewest bytes that bounds and means of its blocks can take."""
    reader = ByteReader(real.side_info, "side information")
    header, _, contexts = (reader.blob() for _ in range(3))
    blocks = ByteWriter()
    for _ in range(7):
        blocks.signed(0)
        blocks.unsigned(0)
        blocks.blob(b"")
    boxes = bytes(7 * math.ceil(num / packetization.block_size))
    side_info = b"".join(map(framed, (header, boxes + blocks.bytes(), contexts)))
    return stream_of(GAUSSIANS, packetization, num, side_info, num_packets)


def of_causal(
    layout: AnchorLayout, position_bytes: int, hidden: int, packetization: Packetization, num_packets: int
) -> SceneStream:
    """Anchors of the causal model, one per bit, all at one position; networks of zeros."""
    config, head = CausalConfig(layout, 16), layout.feature_dim + 4
    nowhere = AnchorPositions(*(np.zeros(n, dtype=np.int64) for n in (3, 0, 0)))
    num, low_bit_probabilities = 8 * position_bytes, bytes([64, 21]) + bytes([128]) * 231
    places = CoarsePositions(
        low_bit_probabilities + bytes([0, 0, 0, 63]) + bytes(position_bytes), nowhere, np.zeros((1, 1), np.int64)
    )
    groups, ones = len(layout.feature_groups), np.ones(3, dtype=np.int64)
    info = CausalInfo(
        config, 0.1, places, 0 * ones, 1000 * ones, np.full(groups + 1, 0.1), np.full(2, 1 << (LOG_BITS - 3)),
        np.zeros(4, dtype=np.int64), {name: zeros(i, hidden, o) for name, (i, o) in config.shapes().items()},
        tuple(zeros(head, hidden, size * layout.num_offsets) for size in (1, 7, 3)),
    )  # fmt: skip
    return stream_of(CAUSAL, packetization, num, write_causal(info), num_packets)


def of_hacpp(
    layout: AnchorLayout, position_bytes: int, hidden: int, packetization: Packetization, num_packets: int
) -> SceneStream:
    """Anchors of format 1, one per bit, all at one position; networks of zeros."""
    grid = HashGridConfig(4, (18, 24), (130,), 13, 15)
    config, head, features = HacppConfig(layout, grid), layout.feature_dim + 4, layout.feature_dim
    before = np.cumsum([0, *layout.feature_groups]).tolist()
    rows, num = sum(grid.rows(3)) + 3 * sum(grid.rows(2)), 8 * position_bytes
    corner = np.ones(3, dtype=np.float32)
    info = HacppInfo(
        config, 0.1, -corner, corner, np.zeros((1, 3), dtype=np.int64), np.ones((rows, 4), dtype=np.int8),
        zeros(grid.context_dim, hidden, config.prior_dim),
        tuple(zeros(b + 3 * features, hidden, 3 * g) for b, g in zip(before, layout.feature_groups, strict=False)),
        (*(zeros(head, hidden, size * layout.num_offsets) for size in (1, 7, 3)),),
        np.full(MASK_CONTEXTS * layout.num_offsets, 128), {"masks": b""} if packetization.separated else {},
    )  # fmt: skip
    reader = ByteReader(write_hacpp(info), "side information")
    parts = [reader.blob() for _ in range(7)]
    parts[1] = bytes([0, 0, 0, 63]) + bytes(position_bytes)
    side_info = b"".join(map(framed, parts)) + reader.rest()
    return stream_of(HACPP_ANCHORS, packetization, num, side_info, num_packets, layout)


def zeros(inputs: int, hidden: int, outputs: int) -> QuantisedMlp:
    """A network with very small coded weights."""

    def layer(columns: int, rows: int) -> QuantisedLinear:
        steps, shifts = np.ones(rows, dtype=np.int64), np.zeros(columns, dtype=np.int64)
        return QuantisedLinear(np.zeros((rows, columns), dtype=np.int32), steps, shifts, np.zeros(rows, dtype=np.int32))

    return QuantisedMlp(layer(inputs, hidden), layer(hidden, outputs), leaky=False)


def stream_of(
    schema_name: str,
    packetization: Packetization,
    num: int,
    side_info: bytes,
    num_packets: int,
    layout: AnchorLayout | None = None,
    tiers: tuple[TierCounts, ...] = (),
    packets: int | None = None,
) -> SceneStream:
    """A stream with empty first packets; it announces a number of packets, or one per block and part."""
    shape = () if layout is None else (layout.feature_dim, layout.num_offsets, layout.feature_groups)
    parts = 2 + len(layout.feature_groups) if packetization.separated and layout else 1
    blocks = math.ceil(num / packetization.block_size)
    manifest = Manifest(
        packetization=packetization, num_elements=num, stream_id=7,
        num_packets=blocks * parts if packets is None else packets,
        side_info_bytes=len(side_info), side_info_digest=hashlib.sha256(side_info).hexdigest(),
        symbols_digest="0" * 64, writer="greedy", schema_name=schema_name, tiers=tiers,
        **dict(zip(("feature_dim", "num_offsets", "feature_groups"), shape, strict=False)),
    )  # fmt: skip
    plan, names = manifest.plan, []
    for n in range(num_packets):
        block, part = divmod(n, parts)
        if block < blocks:
            names.append(PacketId(block, 0, plan.parts[part]))
    return SceneStream(manifest, side_info, tuple(make_packet(name, plan.count(name), b"", 7) for name in names))


def measure(warm: Path, folder: Path, *paths: Path) -> list[dict[str, object]]:
    """Peak memory in MB of processing each stream above that of a small one, and the messages."""
    import resource

    from splatwire.bitstream import read_stream
    from splatwire.cli._run_inspect import describe
    from splatwire.codec import ProgressiveDecoder, decode_stream
    from splatwire.concealment import conceal
    from splatwire.errors import SplatwireError
    from splatwire.io import save_decoded
    from splatwire.sequence import SequenceDecoder
    from splatwire.sequence.decoding import decode_frames

    def progressive(stream: SceneStream) -> None:
        if stream.manifest.schema.timed:
            clip = SequenceDecoder(stream.manifest, stream.side_info)
            for packet in stream.packets:
                clip.push(packet)
            clip.frame(0)
            return
        decoder = ProgressiveDecoder(stream.manifest, stream.side_info)
        for packet in stream.packets:
            decoder.add([packet])

    def saved(stream: SceneStream) -> None:
        received = decode_stream(stream)
        if stream.manifest.schema.timed:
            for _ in itertools.islice(decode_frames(received.scene), 2):
                pass
            return
        save_decoded(received, None, folder / ("out.ply" if stream.manifest.schema.explicit else "out.scene"))

    def dropped(stream: SceneStream) -> None:
        received = decode_stream(stream)
        if stream.manifest.schema.timed:
            next(decode_frames(received.scene, "drop"))
        else:
            conceal(received, "drop")

    works: dict[str, Callable[[Path], object]] = {
        "inspect": describe,
        "progressive": lambda file: progressive(read_stream(file)[0]),
        "decode": lambda file: saved(read_stream(file)[0]),
        "drop": lambda file: dropped(read_stream(file)[0]),
    }
    for work in works.values():
        work(warm)
    before, found = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, []
    for path in paths:
        said: dict[str, object] = {}
        for name, work in works.items():
            try:
                work(path)
            except SplatwireError as error:
                said[name] = f"{type(error).__name__}: {error}"
            said[f"{name} MB"] = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024
        found.append(said)
    return found


if __name__ == "__main__":
    print(json.dumps(measure(*map(Path, sys.argv[1:]))))
