"""Incremental decoding equals `decode_stream` for any packet order, time or thread."""

import dataclasses
import random
import threading

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

from random_numbers import Numbers
from scenes import tiny_scene
from splatwire.bitstream import PacketId, Packetization, SceneStream, make_packet
from splatwire.codec import decode_stream, decoding, encode_scene
from splatwire.codec.progressive import ProgressiveDecoder
from splatwire.codec.schema import PacketBatch
from splatwire.errors import BitstreamError, DesyncError, MissingSideInfoError
from splatwire.types import Prior, ReceivedScene

PACKETIZATIONS = {
    "stratified": Packetization(block_size=200, lanes=4),
    "contiguous": Packetization(block_size=200, lanes=3, grouping="contiguous", order="raster"),
    "hashed": Packetization(block_size=200, lanes=1, grouping="hashed", packet_bytes=700),
}


@pytest.fixture(scope="module", params=[*PACKETIZATIONS, "stratified in tiers", "hashed in tiers"])
def stream(request) -> SceneStream:
    name, _, tiered = request.param.partition(" in ")
    important = Numbers(1).rand(500) < 0.2
    tiers = (~important).astype(np.uint8) if tiered else None
    return encode_scene(tiny_scene(seed=5, num_anchors=500), PACKETIZATIONS[name], tiers=tiers)


def start(stream: SceneStream) -> ProgressiveDecoder:
    return ProgressiveDecoder(stream.manifest, stream.side_info, threads=1)


def shuffled(stream: SceneStream, seed: int) -> list:
    packets = list(stream.packets)
    random.Random(seed).shuffle(packets)
    return packets


def assert_same(a: ReceivedScene, b: ReceivedScene) -> None:
    assert np.array_equal(a.loss_mask.received, b.loss_mask.received)
    for name in ("positions", "features", "scalings", "offsets", "mask"):
        assert np.array_equal(getattr(a.scene.anchors, name), getattr(b.scene.anchors, name)), name
    assert np.array_equal(a[Prior].context_features, b[Prior].context_features)
    for name in ("feature", "scaling", "offset"):
        for part in ("mean", "scale", "step"):
            assert np.array_equal(getattr(getattr(a[Prior], name), part), getattr(getattr(b[Prior], name), part)), name
    assert np.array_equal(a.scene.heads.color.output.weight, b.scene.heads.color.output.weight)


def test_progressive_state_equals_decoding_the_same_packets(stream):
    decoder, packets = start(stream), shuffled(stream, 1)
    assert_same(decoder.received_scene, decode_stream(stream.with_packets([])))
    for number in range(0, len(packets), 3):
        ranks = decoder.add(packets[number : number + 3])
        there = packets[: number + 3]
        assert len(ranks) == sum(packet.num_elements for packet in packets[number : number + 3])
        assert_same(decoder.received_scene, decode_stream(stream.with_packets(there)))
    assert decoder.complete
    assert decoder.stream.packets == stream.packets


@pytest.mark.parametrize("seed", [2, 3])
def test_packet_order_does_not_change_the_scene(stream, seed):
    decoder = start(stream)
    ranks = np.concatenate([decoder.add([packet]) for packet in shuffled(stream, seed)])
    assert sorted(ranks.tolist()) == list(range(stream.manifest.num_elements))
    assert_same(decoder.received_scene, decode_stream(stream))


def test_duplicate_and_foreign_packets_are_counted_and_ignored(stream):
    decoder, first = start(stream), stream.packets[0]
    assert len(decoder.add([first, first])) == first.num_elements
    assert len(decoder.add([first])) == 0
    nowhere = make_packet(PacketId(10_000, 0), first.num_elements, first.payload)
    too_many = make_packet(stream.packets[1].id, 5000, first.payload)
    assert len(decoder.add([nowhere, too_many])) == 0
    assert_same(decoder.received_scene, decode_stream(stream.with_packets([first])))
    assert (decoder.report.num_duplicate, decoder.report.num_corrupt, decoder.report.num_received) == (2, 2, 1)


def test_packets_may_come_from_several_threads(stream):
    decoder, packets = start(stream), shuffled(stream, 4)
    parts = [packets[0::3] + packets[0::5], packets[1::3], packets[2::3]]
    threads = [threading.Thread(target=lambda part=part: [decoder.add([p]) for p in part]) for part in parts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert decoder.complete
    assert decoder.report.num_duplicate == len(packets[0::5])
    assert_same(decoder.received_scene, decode_stream(stream))


def test_snapshot_is_not_changed_by_later_packets(stream):
    decoder, packets = start(stream), shuffled(stream, 6)
    decoder.add(packets[:2])
    held = decoder.snapshot()
    decoder.add(packets[2:])
    assert_same(held, decode_stream(stream.with_packets(packets[:2])))


def test_wrong_integers_fail_the_digest_once_complete(stream):
    wrong = dataclasses.replace(stream.manifest, symbols_digest="0" * 64)
    decoder = ProgressiveDecoder(wrong, stream.side_info)
    decoder.add(stream.packets[1:])
    with pytest.raises(DesyncError, match="not those that were encoded"):
        decoder.add(stream.packets[:1])


def test_changed_payload_fails_the_digest_once_complete(stream):
    second = stream.packets[2]
    spoiled = make_packet(second.id, second.num_elements, second.payload[::-1])
    decoder = start(stream)
    decoder.add(stream.packets[:2])
    decoder.add([spoiled])
    with pytest.raises(DesyncError):
        decoder.add(stream.packets[3:])


def test_missing_or_inconsistent_side_information_is_refused(stream):
    with pytest.raises(MissingSideInfoError):
        ProgressiveDecoder(stream.manifest, b"")
    other = dataclasses.replace(stream.manifest, feature_dim=10, feature_groups=(5, 5))
    with pytest.raises(BitstreamError, match="layout"):
        ProgressiveDecoder(other, stream.side_info)


def test_progress_reaches_the_end(stream):
    shares: list[float] = []
    assert ProgressiveDecoder(stream.manifest, stream.side_info, progress=shares.append).received_scene
    assert shares[-1] == 1.0


def test_datagram_is_decoded_in_the_calling_thread(monkeypatch):
    stream = encode_scene(tiny_scene(seed=5, num_anchors=500), PACKETIZATIONS["hashed"])
    decoder, seen = ProgressiveDecoder(stream.manifest, stream.side_info, threads=2), []
    decode = decoder._decode

    def watched(batch: PacketBatch) -> object:
        blas = ThreadpoolController().select(user_api="blas").info()
        seen.append((threading.current_thread() is threading.main_thread(), {b["num_threads"] for b in blas}))
        return decode(batch)

    monkeypatch.setattr(decoder, "_decode", watched)
    with threadpool_limits(limits=2):
        decoder.add(stream.packets[:1])
        assert {b["num_threads"] for b in ThreadpoolController().select(user_api="blas").info()} == {2}
        monkeypatch.setattr(decoding, "CHUNK", sum(packet.num_elements for packet in stream.packets[1:-1]))
        decoder.add(stream.packets[1:])
    assert seen == [(True, {1}), (False, {1}), (False, {1})]
    assert_same(decoder.received_scene, decode_stream(stream))


def test_snapshot_copies_only_arrays_that_packets_fill():
    """Only arrays that packets fill are copied; the others, including the background, are shared."""
    scene = dataclasses.replace(tiny_scene(seed=5, num_anchors=500), background=(0.25, 0.5, 1.0))
    stream = encode_scene(scene, PACKETIZATIONS["stratified"])
    decoder = start(stream)
    decoder.add(stream.packets[:5])
    fixed, there = decoder.snapshot(), decode_stream(stream.with_packets(stream.packets[:5]))
    assert fixed.scene.background == (0.25, 0.5, 1.0)
    assert_same(fixed, there)
    for field in dataclasses.fields(fixed.scene):
        if field.name != "anchors":
            assert getattr(fixed.scene, field.name) == getattr(decoder.received_scene.scene, field.name), field.name
    decoder.add(stream.packets[5:])
    assert_same(fixed, there)
    assert decoder.snapshot().sections == decoder.received_scene.sections
