"""Pinned bytes of the wire format. A change needs a new version number."""

import numpy as np

from splatwire.bitstream import (
    PRESETS,
    PacketId,
    Packetization,
    PacketPlan,
    make_packet,
    make_stream,
    manifest_to_bytes,
    stream_from_bytes,
    stream_to_bytes,
)
from splatwire.channel import LOSS_PRESETS, Bernoulli, transmit

LANES_1337 = [3, 7, 2, 1, 3, 5, 1, 4, 1, 5, 2, 6, 5, 1, 6, 2, 7, 1, 3, 5, 5, 3, 0, 6, 7, 3, 5, 1, 6, 1, 4, 2]
PACKET_HEX = "01ddccbbaa010745230177019e16bebc73706c6174"
MANIFEST = (
    '{"digest":"fb8f53576189e993","feature_dim":3,"feature_groups":[1,2],"format_version":1,"num_anchors"'
    ':6,"num_offsets":2,"num_packets":3,"packetization":{"block_size":4,"grouping":"stratified","lanes":2'
    ',"order":"morton","packaging":"atomic","seed":1337},"schema":"splatwire/stream","side_info_bytes":4,'
    '"side_info_digest":"ea7bf4bb723041e7d63fe6c74dc46c048c617eb49a454a1cd6edbf34d05a418e","stream_id":"2'
    '7fde51b","symbols_digest":"5555555555555555555555555555555555555555555555555555555555555555","writer'
    '":"golden"}'
)
STREAM_HEAD_HEX = "9353575a01ff010000"
RECORDS_HEX = (
    "18000000011be5fd270000000000010001f9606d7061796c6f616400"
    "18000000011be5fd2700010000000300dcf89d837061796c6f616401"
    "18000000011be5fd2700010100000200dd1bc0287061796c6f616402"
)


def tiny_stream():
    p = Packetization(block_size=4, lanes=2)
    plan = PacketPlan(p, 6)
    return make_stream(
        packetization=p,
        num_elements=6,
        feature_dim=3,
        num_offsets=2,
        feature_groups=(1, 2),
        side_info=b"side",
        packets=[make_packet(i, plan.count(i), b"payload" + bytes([n])) for n, i in enumerate(plan.ids)],
        symbols_digest="5" * 64,
        writer="golden",
    )


def test_lanes_of_the_first_ranks_are_pinned():
    assert (PacketPlan(PRESETS["paper"], 32).packet_index_of() % 8).tolist() == LANES_1337


def test_packet_bytes_are_pinned():
    packet = make_packet(PacketId(0x012345, 7, 1), 0x0177, b"splat", 0xAABBCCDD)
    assert packet.data.hex() == PACKET_HEX


def test_stream_bytes_are_pinned():
    stream = tiny_stream()
    assert manifest_to_bytes(stream.manifest).decode() == MANIFEST
    golden = bytes.fromhex(STREAM_HEAD_HEX) + MANIFEST.encode() + b"side" + bytes.fromhex(RECORDS_HEX)
    assert stream_to_bytes(stream) == golden
    assert stream_from_bytes(golden)[0] == stream


def test_loss_masks_are_pinned():
    """A seed gives the same loss in every release, so that published results are reproducible."""
    assert np.flatnonzero(~Bernoulli(0.2).received(48, generator())).tolist() == [2, 3, 11, 13, 15, 20, 21, 32]
    assert np.flatnonzero(~LOSS_PRESETS["webrtc-20/3"].received(48, generator())).tolist() == [0, 1, 3, 12, 13, 21]
    assert transmit(tiny_stream(), Bernoulli(0.5), seed=0)[1].lost == ("pak_lane1_s0.pak", "pak_lane1_s1.pak")


def generator() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(0))
