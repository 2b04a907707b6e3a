"""Mutated streams with valid checksums decode to finite Gaussians or to one error.

`SPLATWIRE_FUZZ_CASES=100000 pytest tests/codec/gaussians/test_mutations.py` runs long; a case is its number.
"""

import dataclasses
import os

import numpy as np
import pytest

from explicit import decode_splats, encode_splats
from splatwire.bitstream import (
    GAUSSIANS,
    PacketId,
    Packetization,
    SceneStream,
    make_packet,
    make_stream,
    stream_from_bytes,
    stream_to_bytes,
)
from splatwire.codec.gaussians.side_info import read_side_info, write_side_info
from splatwire.errors import SplatwireError
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow

CASES = int(os.environ.get("SPLATWIRE_FUZZ_CASES", "500"))
NUMBERS = (
    0,
    1,
    -1,
    7,
    8,
    63,
    64,
    127,
    128,
    255,
    256,
    4096,
    -4096,
    65535,
    2**21,
    2**31,
    -(2**31),
    2**40,
    2**62,
    -(2**62),
)
LAYOUTS = (
    Packetization(block_size=40, lanes=1, grouping="hashed", packet_bytes=256),
    Packetization(block_size=30, lanes=3),
    Packetization(block_size=80, lanes=2, grouping="contiguous"),
)


def small_stream(layout: Packetization, degree: int) -> SceneStream:
    rng = np.random.default_rng(degree)
    splats = Splats(
        rng.standard_normal((70, 3), np.float32),
        rng.standard_normal((70, 4), np.float32),
        rng.random((70, 3), np.float32) + np.float32(0.01),
        rng.random(70, np.float32) * np.float32(0.9) + np.float32(0.05),
        rng.standard_normal((70, (degree + 1) ** 2, 3), np.float32),
    )
    return encode_splats(splats, layout)


@pytest.fixture(scope="module")
def streams() -> list[SceneStream]:
    return [small_stream(layout, degree) for layout in LAYOUTS for degree in (0, 2)]


def hit(data: bytes, rng: np.random.Generator) -> bytes:
    """Overwrites, removes or inserts a few random bytes."""
    raw = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        at, kind = int(rng.integers(0, max(len(raw), 1))), rng.integers(0, 4)
        if kind == 0:
            del raw[at : at + int(rng.integers(1, 20))]
        elif kind == 1:
            raw[at:at] = rng.bytes(int(rng.integers(1, 20)))
        else:
            raw[at : at + 1] = bytes([rng.choice([0, 1, 127, 128, 255, rng.integers(256)])])
    return bytes(raw)


def rebuilt(stream: SceneStream, side_info: bytes, packets: list) -> SceneStream:
    """Stream with other content and valid checksums and digests."""
    m = stream.manifest
    return make_stream(
        packetization=m.packetization, num_elements=m.num_elements, side_info=side_info, packets=packets,
        symbols_digest=m.symbols_digest, writer=m.writer, tiers=m.tiers, schema_name=GAUSSIANS,
    )  # fmt: skip


def changed_fields(stream: SceneStream, rng: np.random.Generator) -> bytes:
    """Side information with some changed numbers."""
    info = read_side_info(stream.side_info, stream.manifest.plan.num_blocks)
    names = ("base_exponents", "transform", "block_means", "zero_probabilities", "scale_indices")
    arrays = {name: getattr(info, name).copy() for name in names}
    arrays |= {name: getattr(info.boxes, name).copy() for name in ("shifts", "grid_corners", "extents")}
    ranges = {"transform": (-128, 127), **dict.fromkeys(("zero_probabilities", "shifts", "extents"), (0, 255))}
    ranges |= dict.fromkeys(("block_means", "scale_indices"), (-(2**31), 2**31))
    numbers = {"size_log": info.size_log, "lattice_bits": info.lattice_bits}
    for _ in range(rng.integers(1, 4)):
        name = rng.choice([*arrays, *numbers])
        low, high = ranges.get(name, (-(2**62), 2**62))
        value = int(np.clip(NUMBERS[rng.integers(len(NUMBERS))], low, high))
        if name in numbers:
            numbers[name] = value
        elif arrays[name].size:
            arrays[name].flat[rng.integers(arrays[name].size)] = value
    boxes = dataclasses.replace(info.boxes, **{k: arrays.pop(k) for k in ("shifts", "grid_corners", "extents")})
    return write_side_info(dataclasses.replace(info, boxes=boxes, **arrays, **numbers))


def lie(stream: SceneStream, rng: np.random.Generator) -> SceneStream:
    kind, packets, side_info = rng.integers(0, 6), list(stream.packets), stream.side_info
    if kind == 0:
        return stream_from_bytes(hit(stream_to_bytes(stream), rng))[0]
    if kind == 1:
        side_info = hit(side_info, rng)
    elif kind == 2:
        side_info = changed_fields(stream, rng)
    for i in rng.choice(len(packets), int(rng.integers(0, 4))):
        p = packets[i]
        if kind == 3:
            block, lane, count = (int(n) for n in rng.integers(0, 80, 3))
            p = make_packet(PacketId(block, lane), count, p.payload)
        else:
            payload = rng.bytes(int(rng.integers(0, 300))) if kind == 4 else hit(p.payload, rng)
            p = make_packet(p.id, p.num_elements, payload)
        packets[i] = p
    kept = [p for p in packets if rng.random() < 0.9]
    return rebuilt(stream, side_info, packets).with_packets(kept)


def decoded_or_refused(stream: SceneStream, rng: np.random.Generator) -> tuple[Splats | None, np.ndarray]:
    message = ""
    try:
        return decode_splats(lie(stream, rng), threads=1)[:2]
    except SplatwireError as error:
        message = str(error)
    assert 10 < len(message) < 500
    return None, np.zeros(0, bool)


@pytest.mark.parametrize("part", range(10))
def test_mutated_streams_decode_to_finite_gaussians_or_are_refused(streams: list[SceneStream], part: int) -> None:
    decoded = 0
    for case in range(part, CASES, 10):
        rng = np.random.default_rng(case)
        found, known = decoded_or_refused(streams[rng.integers(len(streams))], rng)
        if found is None:
            continue
        decoded += 1
        assert len(known) == found.num_gaussians, case
        for name, values in vars(found).items():
            assert bool(np.isfinite(values).all()), (case, name)
        assert float(found.scales.min()) > 0, case
        assert 0 <= float(found.opacities.min()) <= float(found.opacities.max()) < 1, case
    assert decoded > CASES / 100
