"""Pinned streams of explicit Gaussians and their decoded integers, for decoders of format 2 in any language.

`gaussians_3.json` contains whole files in base64 and their content; this file, run as a program, writes it. The streams
of `gaussians.json` are of version 2, which is no longer written.
"""

import base64
import json
from pathlib import Path

import numpy as np
import pytest

from explicit import decode_splats, encode_splats
from reference.gaussian_packets import ReferencePacket
from splatwire.bitstream import PRESETS, Packetization, arrived_blocks, stream_from_bytes, stream_to_bytes
from splatwire.codec.gaussians.decoder import decode_packets, open_side_info
from splatwire.codec.gaussians.quality import Quality
from splatwire.types.splats import Splats

FILE = Path(__file__).with_name("gaussians_3.json")
OLD = FILE.with_name("gaussians.json")
DATAGRAM = Packetization(block_size=60, lanes=1, grouping="hashed", packet_bytes=500)
CASES = {
    "spread": (90, 0, DATAGRAM, Quality(8.0)),
    "together": (40, 1, Packetization(block_size=40, lanes=2, grouping="contiguous"), Quality(9.5, position=1.0)),
    "lanes": (50, 2, Packetization(block_size=30, lanes=3), Quality(7.0, classes=4)),
    "one": (1, 3, PRESETS["datagram"], Quality(12.0)),
}


def make(name: str) -> dict:
    count, degree, packetization, quality = CASES[name]
    rng = np.random.default_rng(len(name))
    means = rng.normal(size=(count, 3)) * [1, 1, 0.1] + 2
    arrays = (
        means,
        rng.normal(size=(count, 4)),
        np.exp(rng.normal(size=(count, 3)) - 4),
        rng.uniform(0.05, 0.99, count),
        rng.normal(size=(count, (degree + 1) ** 2, 3)) * 0.2,
    )
    splats = Splats(*(a.astype(np.float32) for a in arrays))
    stream = encode_splats(splats, packetization, class_offsets=rng.integers(-5, 1, count), quality=quality)
    rows, harmonics = integers(stream)
    decoded = decode_splats(stream)[0]
    return {
        "swz": base64.b64encode(stream_to_bytes(stream)).decode(),
        "num_gaussians": count,
        "degree": degree,
        "packets": [[p.id.block, p.id.index_in_block, p.num_elements] for p in stream.packets],
        "rows": rows.tolist(),
        "harmonics": harmonics.tolist(),
        "decoded": {key: np.round(values.astype(np.float64), 6).tolist() for key, values in vars(decoded).items()},
    }


def integers(stream):
    """Rows and harmonics of all Gaussians, block by block in the order of the packets."""
    info = open_side_info(stream.manifest, stream.side_info)
    found = [
        decode_packets(info, block.block, block.counts, block.payloads)
        for block in arrived_blocks(stream.manifest.plan, stream.packets)
    ]
    return tuple(np.concatenate(part) for part in zip(*found, strict=True))


@pytest.fixture(scope="module", params=[FILE, OLD], ids=["version 3", "version 2"])
def pinned(request):
    return json.loads(request.param.read_text())


@pytest.mark.parametrize("name", CASES)
def test_pinned_bytes_decode_to_pinned_integers(name, pinned):
    case = pinned[name]
    stream = stream_from_bytes(base64.b64decode(case["swz"]))[0]
    rows, harmonics = integers(stream)
    assert rows.tolist() == case["rows"]
    assert harmonics.tolist() == case["harmonics"]
    decoded, known = decode_splats(stream)
    assert known.all()
    for key, values in vars(decoded).items():
        np.testing.assert_allclose(values, case["decoded"][key], rtol=1e-5, atol=2e-6)


@pytest.mark.parametrize("name", CASES)
def test_plain_python_decodes_the_pinned_bytes(name, pinned):
    case = pinned[name]
    stream = stream_from_bytes(base64.b64decode(case["swz"]))[0]
    info, at = open_side_info(stream.manifest, stream.side_info), 0
    for packet in stream.packets:
        found = ReferencePacket(info, packet.id.block, packet.payload, packet.num_elements).decode()
        assert [g.row() for g in found] == case["rows"][at : at + len(found)]
        assert [g.harmonics for g in found] == case["harmonics"][at : at + len(found)]
        at += len(found)
    assert at == case["num_gaussians"]


@pytest.mark.parametrize("name", CASES)
def test_an_encoder_writes_the_pinned_bytes(name):
    pinned = json.loads(FILE.read_text())[name]
    ours, theirs = (stream_from_bytes(base64.b64decode(case["swz"]))[0] for case in (make(name), pinned))
    assert ours.side_info == theirs.side_info
    assert ours.packets == theirs.packets


if __name__ == "__main__":
    FILE.write_text(json.dumps({name: make(name) for name in CASES}, separators=(",", ":")) + "\n")
