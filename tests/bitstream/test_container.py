import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from splatwire.bitstream import (
    HEADER_BYTES,
    Packetization,
    SceneStream,
    make_packet,
    make_stream_id,
    stream_from_bytes,
    stream_to_bytes,
)
from splatwire.bitstream.packet import packet_mark
from splatwire.bitstream.scene_stream import FILE_PREFIX, RECORD_PREFIX
from splatwire.errors import BitstreamError, MissingSideInfoError, SplatwireError, UnsupportedVersionError


@pytest.fixture(scope="module")
def small(make_test_stream) -> SceneStream:
    """Stream of nine packets of a few bytes, for tests that change every byte."""
    return make_test_stream(num_elements=150, packetization=Packetization(block_size=50, lanes=3), payload_bytes=12)


def packets_start(stream: SceneStream) -> int:
    parts = stream.part_sizes()
    return FILE_PREFIX.size + parts["manifest"] + parts["side_info"]


def records(stream: SceneStream) -> list[bytes]:
    packed = [packet.data for packet in stream.packets]
    return [RECORD_PREFIX.pack(len(data)) + data for data in packed]


def head(stream: SceneStream) -> bytes:
    return stream_to_bytes(stream)[: packets_start(stream)]


def test_stream_round_trips_with_the_expected_size(stream):
    data = stream_to_bytes(stream)
    found, report = stream_from_bytes(data)
    assert found == stream
    assert report.complete
    assert (report.num_expected, report.num_received, report.problems) == (28, 28, ())
    assert len(data) == stream.num_bytes == sum(stream.part_sizes().values())


def test_flipped_packet_byte_loses_one_packet(small):
    """The flipped byte is in a payload, a header or a packet's size."""
    data = stream_to_bytes(small)
    for at in range(packets_start(small), len(data)):
        damaged = bytearray(data)
        damaged[at] ^= 0xFF
        found, report = stream_from_bytes(bytes(damaged))
        assert (report.num_missing, report.num_corrupt) == (1, 1)
        assert set(found.packets) < set(small.packets)


def test_flipped_header_byte_is_one_error(small):
    data = stream_to_bytes(small)
    for at in range(packets_start(small)):
        damaged = bytearray(data)
        damaged[at] ^= 0xFF
        with pytest.raises(BitstreamError):
            stream_from_bytes(bytes(damaged))


def test_truncated_file_keeps_earlier_packets(small):
    data, start = stream_to_bytes(small), packets_start(small)
    ends = np.cumsum([start, *map(len, records(small))])
    for size in range(len(data)):
        if size < start:
            with pytest.raises(BitstreamError):
                stream_from_bytes(data[:size])
            continue
        found, report = stream_from_bytes(data[:size])
        whole = int(np.searchsorted(ends, size, side="right")) - 1
        assert found.packets == small.packets[:whole]
        assert report.num_missing == 9 - whole
        assert report.num_corrupt == (size not in ends)


def test_duplicates_foreign_and_reordered_packets_are_counted(stream, make_test_stream):
    mine, foreign = records(stream), records(make_test_stream(seed=5))
    data = head(stream) + b"".join([*mine[::-1], mine[3], foreign[0], mine[3], foreign[9]])
    found, report = stream_from_bytes(data)
    assert found == stream
    assert (report.num_missing, report.num_corrupt, report.num_foreign, report.num_duplicate) == (0, 0, 2, 2)
    assert len(report.problems) == 4


def test_packets_of_another_plan_are_rejected(stream, make_test_stream):
    """Packets with the right stream id that do not belong to the manifest's plan."""
    other = make_test_stream(num_elements=900)
    forged = [make_packet(p.id, p.num_elements, p.payload, stream.manifest.stream_id).data for p in other.packets]
    data = head(stream) + b"".join(RECORD_PREFIX.pack(len(p)) + p for p in forged)
    found, report = stream_from_bytes(data)
    kept = {packet.id for packet in found.packets}
    assert kept == {p.id for p in other.packets if p.num_elements == stream.manifest.plan.count(p.id)}
    assert report.num_corrupt == len(forged) - len(kept) > 0


def test_newer_packets_are_lost_and_newer_files_refused(stream):
    data = bytearray(stream_to_bytes(stream))
    data[packets_start(stream) + RECORD_PREFIX.size] = 2
    _, report = stream_from_bytes(bytes(data))
    assert (report.num_missing, report.num_corrupt) == (1, 1)
    assert "version 2" in report.problems[0]
    data[4] = 2
    with pytest.raises(UnsupportedVersionError, match=r"scene\.swz has layout version 2"):
        stream_from_bytes(bytes(data), "scene.swz")


def test_missing_side_information_is_named(stream):
    data, start = stream_to_bytes(stream), packets_start(stream)
    with pytest.raises(MissingSideInfoError, match=r"side information of scene\.swz has 199 of 200 bytes"):
        stream_from_bytes(data[: start - 1], "scene.swz")
    damaged = bytearray(data)
    damaged[start - 1] ^= 1
    with pytest.raises(MissingSideInfoError, match=r"side information of scene\.swz is damaged"):
        stream_from_bytes(bytes(damaged), "scene.swz")


@pytest.mark.parametrize("data", [b"", b"\x93", b"ply\n", b"\x93SWZ", b"\x93SWZ\x01\xff\xff\xff\xff" + bytes(100)])
def test_other_files_are_refused(data):
    with pytest.raises(BitstreamError, match="scan"):
        stream_from_bytes(data, "scan")


def test_stream_id_depends_on_all_content(stream, make_test_stream):
    p, side, packets = stream.manifest.packetization, stream.side_info, stream.packets
    ids = {
        make_stream_id(p, side, packets),
        make_stream_id(Packetization(block_size=100, lanes=4, seed=1), side, packets),
        make_stream_id(p, side + b"\0", packets),
        make_stream_id(p, side, packets[:-1]),
        make_stream_id(p, side, make_test_stream(seed=1).packets),
    }
    assert len(ids) == 5
    assert stream.manifest.stream_id in ids


def test_file_of_fake_packet_headers_is_read_in_linear_time(stream):
    """Every five bytes look like a header of a packet as long as the remaining file, quadratic for a naive reader."""
    mark = records(stream)[0][RECORD_PREFIX.size : RECORD_PREFIX.size + 5]
    size = 400_000
    data = head(stream) + b"".join(
        RECORD_PREFIX.pack(size - 9 * i - RECORD_PREFIX.size) + mark for i in range(size // 9)
    )
    found, report = stream_from_bytes(data + bytes(size))
    assert found.packets == ()
    assert report.num_missing == 28
    assert "too much is damaged" in report.problems[-1]


def fuzzed(rng: np.random.Generator, start: bytes, mine: list[bytes], foreign: list[bytes]) -> tuple[bytes, bool]:
    """Random file of intact, damaged, repeated and foreign records; and True if its head is intact."""
    chosen = [mine[i] for i in rng.integers(len(mine), size=int(rng.integers(1, 12)))]
    chosen.insert(int(rng.integers(len(chosen))), foreign[int(rng.integers(len(foreign)))])
    data, first = bytearray(start + b"".join(chosen)), len(start) if rng.random() < 0.7 else 0
    for at in rng.integers(first, len(data), size=int(rng.integers(4))):
        data[at] = int(rng.integers(256))
    if rng.random() < 0.3:
        del data[int(rng.integers(first, len(data))) :]
    return bytes(data), bytes(data[: len(start)]) == start


@pytest.mark.slow
def test_mutated_files_are_read_or_refused(stream, make_test_stream):
    """4000 files: every accepted packet equals a written one, and only errors of the project are raised."""
    rng, known = np.random.default_rng(2), set(stream.packets)
    start, mine, foreign = head(stream), records(stream), records(make_test_stream(seed=5))
    num_errors = 0
    for _ in range(4000):
        data, head_intact = fuzzed(rng, start, mine, foreign)
        try:
            found, report = stream_from_bytes(data)
        except SplatwireError:
            assert not head_intact
            num_errors += 1
            continue
        assert head_intact
        assert (found.manifest, found.side_info) == (stream.manifest, stream.side_info)
        assert known.issuperset(found.packets)
        assert report.num_received == len(found.packets)
        assert report.num_foreign <= 1
    assert 400 < num_errors < 1200


def peak_memory(action) -> int:
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_is_bounded_by_the_file(stream):
    """Memory stays bounded even if every size field is the maximum and the manifest's digest is valid."""
    lie = replace(
        stream.manifest,
        packetization=Packetization(block_size=3, lanes=256),
        num_elements=65536 + 1024 * 200,
        num_packets=100_000,
        feature_groups=(4096,),
        feature_dim=4096,
        num_offsets=1024,
    )
    lying = stream_to_bytes(replace(stream, manifest=lie))
    damaged = bytearray(stream_to_bytes(stream))
    for record in range(28):
        at = damaged.find(packet_mark(stream.manifest.stream_id), packets_start(stream) + 40 * record)
        damaged[max(at - 4, 0) : max(at, 0)] = b"\xff\xff\xff\x03"
    assert peak_memory(lambda: stream_from_bytes(lying)) < 1_000_000
    assert peak_memory(lambda: stream_from_bytes(bytes(damaged))) < 1_000_000


def test_header_size_constant_equals_the_written_header(stream):
    assert stream.part_sizes()["packet_headers"] == HEADER_BYTES * 28


def test_memory_is_bounded_by_the_valid_packets(stream, tmp_path):
    """A sparse file: a gigabyte takes no disk space and must take no memory."""
    from splatwire.bitstream import read_stream

    path = tmp_path / "a.swz"
    path.write_bytes(stream_to_bytes(stream))
    with path.open("r+b") as file:
        file.truncate(1 << 28)
    found = []
    assert peak_memory(lambda: found.append(read_stream(path))) < 8 << 20
    assert found[0][0] == stream
    assert found[0][1].num_corrupt == 1


def test_next_packet_is_found_across_search_chunks(small, monkeypatch):
    data, start = stream_to_bytes(small), packets_start(small)
    for size in (1, 3, 5, 64):
        monkeypatch.setattr("splatwire.bitstream.container.SEARCH_BYTES", size)
        for gap in range(12):
            found, report = stream_from_bytes(data[:start] + b"\1" * gap + data[start:])
            assert found == small, (size, gap)
            assert report.num_corrupt == bool(gap)
