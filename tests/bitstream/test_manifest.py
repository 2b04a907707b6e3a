import json
from dataclasses import replace

import numpy as np
import pytest

from splatwire.bitstream import PacketPlan, manifest_from_bytes, manifest_to_bytes
from splatwire.bitstream.manifest import _digest
from splatwire.errors import BitstreamError, InvalidValueError, SplatwireError, UnsupportedVersionError


@pytest.fixture
def manifest(stream):
    return stream.manifest


def signed(content: dict) -> bytes:
    """Manifest with any content and a valid digest, like deliberate damage."""
    content = {key: value for key, value in content.items() if key != "digest"}
    return json.dumps({**content, "digest": _digest(content)}).encode()


def test_manifest_round_trips(manifest):
    data = manifest_to_bytes(manifest)
    assert manifest_from_bytes(data) == manifest
    assert list(json.loads(data)) == sorted(json.loads(data))


def test_json_layout_of_a_manifest_does_not_matter(manifest):
    content = json.loads(manifest_to_bytes(manifest))
    pretty = json.dumps(dict(reversed(content.items())), indent=2).encode()
    assert manifest_from_bytes(pretty) == manifest


def test_manifest_rebuilds_the_packet_plan(manifest):
    again = manifest_from_bytes(manifest_to_bytes(manifest))
    assert again.plan == PacketPlan(manifest.packetization, manifest.num_elements)
    assert len(again.plan.ids) == manifest.num_packets


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("num_anchors", 1 << 40, "num_elements"),
        ("num_anchors", 1 << 28, "cannot place"),
        ("num_anchors", -1, "num_elements"),
        ("num_anchors", True, "num_anchors"),
        ("num_anchors", "700", "num_anchors"),
        ("num_anchors", 70_000, "packets cannot carry"),
        ("num_packets", 29, "packets cannot carry"),
        ("num_packets", 1, "packets cannot carry"),
        ("feature_dim", 51, "add up"),
        ("feature_dim", 1 << 30, "feature_dim"),
        ("feature_groups", [60, -10], "feature_groups"),
        ("feature_groups", [], "add up"),
        ("feature_groups", 50, "not a list"),
        ("feature_groups", [[50]], "integers only"),
        ("num_offsets", 0, "num_offsets"),
        ("side_info_bytes", -1, "side_info_bytes"),
        ("side_info_bytes", 1 << 40, "side_info_bytes"),
        ("side_info_digest", "00", "SHA-256"),
        ("symbols_digest", None, "symbols_digest is not text"),
        ("stream_id", "0xABCDEF", "stream_id"),
        ("stream_id", 5, "stream_id is not text"),
        ("writer", "\n" * 9, "writer"),
        ("writer", "w" * 1000, "writer"),
        ("packetization", None, "packetization is not an object"),
        ("packetization", {}, "lacks block_size"),
        ("format_version", "1", "format_version"),
        ("format_version", 0, "format_version"),
        ("surprise", 1, "unknown fields: 'surprise'"),
        ("\ud800", 1, "unknown fields: .*ud800"),
        ("writer", [[]], "writer is not text"),
    ],
)
def test_inconsistent_manifests_are_refused(manifest, field, value, message):
    content = json.loads(manifest_to_bytes(manifest))
    with pytest.raises(BitstreamError, match=message):
        manifest_from_bytes(signed({**content, field: value}))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("lanes", 0, "lanes"),
        ("block_size", 1 << 20, "block size"),
        ("order", "hilbert", "hilbert"),
        ("order", [], "order"),
    ],
)
def test_inconsistent_packetizations_are_refused(manifest, field, value, message):
    content = json.loads(manifest_to_bytes(manifest))
    content["packetization"][field] = value
    with pytest.raises(BitstreamError, match=message):
        manifest_from_bytes(signed(content))


def test_newer_version_is_reported_first(manifest):
    content = {**json.loads(manifest_to_bytes(manifest)), "format_version": 6, "new_field": {}}
    with pytest.raises(UnsupportedVersionError, match="version 6"):
        manifest_from_bytes(json.dumps(content).encode(), "some/manifest.json")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"null",
        b"{}",
        b"\xff\xfe",
        b"[" * 60_000,
        b'{"schema":"splatwire/stream","x":' + b"[" * 900 + b"]" * 900 + b"}",
        b'{"schema":1e400}',
        b'{"schema":NaN}',
        b'{"a":1,"a":1}',
        b'{"a":' + b"9" * 60_000 + b"}",
        b" " * 100_000,
    ],
)
def test_other_json_is_refused(data):
    with pytest.raises(BitstreamError, match=r"some/manifest\.json"):
        manifest_from_bytes(data, "some/manifest.json")


def test_contradictory_manifest_is_not_constructed(manifest):
    with pytest.raises(InvalidValueError, match="add up"):
        replace(manifest, feature_dim=49)


def test_damaged_manifest_is_refused(manifest):
    """4000 damaged manifests: each is refused or has equal content (white space, escapes)."""
    data, rng = manifest_to_bytes(manifest), np.random.default_rng(1)
    for _ in range(4000):
        damaged = bytearray(data)
        for at in rng.integers(len(data), size=int(rng.integers(1, 4))):
            damaged[at] = int(rng.integers(256)) if rng.random() < 0.5 else rng.choice(list(b'0123456789",:{}[] ae-'))
        if rng.random() < 0.2:
            del damaged[int(rng.integers(len(data))) :]
        try:
            assert manifest_from_bytes(bytes(damaged)) == manifest
        except SplatwireError:
            assert bytes(damaged) != data
