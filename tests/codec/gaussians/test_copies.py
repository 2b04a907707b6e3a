"""Copies of Gaussians in the side information round-trip, and invalid sections are refused by name."""

import base64
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from close import assert_close
from codec.gaussians.test_gaussians import DATAGRAM, covariances, some_splats
from explicit import encode_splats
from splatwire.bitstream import stream_from_bytes
from splatwire.codec import ProgressiveDecoder, decode_stream, with_section
from splatwire.codec.gaussians.copies import SECTION, read_copies
from splatwire.codec.gaussians.copies_encoder import write_copies
from splatwire.codec.gaussians.decoder import open_side_info
from splatwire.codec.gaussians.quality import Quality
from splatwire.concealment import conceal, concealer_names
from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader
from splatwire.types import Copies
from splatwire.types.splats import Splats

GROWTH = (0.25, 0.75, 0.5)
PLACES = np.array([3, 499, 17, 255, 256, 0, 42])


@pytest.fixture(scope="module", params=[0, 2])
def stream(request):
    return encode_splats(some_splats(degree=request.param), DATAGRAM, quality=Quality(11.0))


@pytest.fixture(scope="module")
def section(stream):
    info = open_side_info(stream.manifest, stream.side_info)
    return write_copies(decode_stream(stream).scene.splats, PLACES, info, precision_class=7, growth=GROWTH)


def read(stream, section):
    info = open_side_info(stream.manifest, stream.side_info)
    return read_copies(replace(info, sections={SECTION: section}), stream.manifest.num_elements)


def test_copies_round_trip(stream, section) -> None:
    whole, copies = decode_stream(stream).scene.splats, read(stream, section)
    assert sorted(copies.indices.tolist()) == sorted(PLACES.tolist())
    assert copies.growth == GROWTH
    true = whole.select(copies.indices)
    assert float(np.linalg.norm(copies.splats.means - true.means, axis=1).max()) < 0.01
    assert_close(np.log(copies.splats.scales), np.log(true.scales), atol=0.1, rtol=0)
    assert_close(copies.splats.opacities, true.opacities, atol=0.02, rtol=0.02)
    assert_close(copies.splats.sh, true.sh, atol=0.05, rtol=0)
    size = true.scales.max(axis=1)[:, None, None] ** 2
    assert_close(covariances(copies.splats) / size, covariances(true) / size, atol=0.1, rtol=0)


def test_streams_of_version_2_take_copies_too() -> None:
    """The bundled scene stores other integer types in the same section."""
    pinned = json.loads((Path(__file__).parents[2] / "golden" / "gaussians.json").read_text())["spread"]
    old = stream_from_bytes(base64.b64decode(pinned["swz"]))[0]
    info, whole = open_side_info(old.manifest, old.side_info), decode_stream(old).scene.splats
    places = np.array([3, 17, 42, 89, 0])
    richer = with_section(old, SECTION, write_copies(whole, places, info, precision_class=7, growth=GROWTH))
    received = decode_stream(richer.with_packets(richer.packets[1:]))
    copies, known = received[Copies], received.loss_mask.fully_received
    assert sorted(copies.indices.tolist()) == sorted(places.tolist())
    assert_close(np.log(copies.splats.scales), np.log(whole.select(copies.indices).scales), atol=0.1, rtol=0)
    assert_close(copies.splats.sh, whole.select(copies.indices).sh, atol=0.05, rtol=0)
    lost = ~known[copies.indices]
    assert 0 < int(lost.sum()) < len(places)
    assert np.array_equal(conceal(received, "sketch").splats.means[copies.indices[lost]], copies.splats.means[lost])


def test_lost_gaussians_use_copies_and_received_ones_are_unchanged(stream, section) -> None:
    richer = with_section(stream, SECTION, section)
    lossy = richer.with_packets(richer.packets[::2])
    received = decode_stream(lossy)
    known, copied = received.loss_mask.fully_received, np.zeros(500, np.bool_)
    copied[PLACES] = True
    assert 0 < int((~known & copied).sum()) < len(PLACES)
    drawn = conceal(received, "sketch")
    assert np.array_equal(drawn.hints.left_out, ~(known | copied))
    for name, values in vars(received.scene.splats).items():
        assert np.array_equal(getattr(drawn.splats, name)[known], values[known])
    copies, lost = received[Copies], ~known[received[Copies].indices]
    assert np.array_equal(drawn.splats.means[copies.indices[lost]], copies.splats.means[lost])
    assert float(drawn.hints.size_gain[known].max()) > 1
    assert "sketch" in concealer_names(received.sections, {Splats})
    arriving = ProgressiveDecoder(lossy.manifest, lossy.side_info)
    arriving.add(lossy.packets)
    again = conceal(arriving.snapshot(), "sketch")
    assert np.array_equal(again.drawn().means, drawn.drawn().means)


def test_sketch_requires_copies(stream) -> None:
    received = decode_stream(stream.with_packets(stream.packets[1:]))
    assert "sketch" not in concealer_names(received.sections, {Splats})
    with pytest.raises(InvalidValueError, match="calibrate sketch"):
        conceal(received, "sketch")


def test_inconsistent_sections_are_refused(stream, section) -> None:
    with pytest.raises(UnsupportedVersionError, match="version 9"):
        read(stream, b"\x09" + section[1:])
    for count in (0, 127):
        with pytest.raises(BitstreamError, match="sketch"):
            read(stream, section[:4] + bytes([count]) + section[5:])
    reader = ByteReader(section, "sketch")
    reader.take(5)
    reader.blob()
    at = len(section) - reader.left
    for twice in (b"\x00" * 8, b"\xff" * 8):
        with pytest.raises(BitstreamError, match="an index of a copy is repeated or out of range"):
            read(stream, section[:at] + twice + section[at + 8 :])
    for size in range(at + 7):
        with pytest.raises(BitstreamError):
            read(stream, section[:size])
    info, whole = open_side_info(stream.manifest, stream.side_info), decode_stream(stream).scene.splats
    with pytest.raises(InvalidValueError, match="class of precision 8"):
        write_copies(whole, PLACES, info, precision_class=8, growth=GROWTH)


def test_any_bytes_give_finite_copies_or_an_error(stream, section) -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        data = bytearray(section)
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            data[at] = rng.integers(256)
        try:
            copies = read(stream, bytes(data))
        except BitstreamError:
            continue
        assert all(bool(np.isfinite(values).all()) for values in vars(copies.splats).values())
        assert float(copies.splats.scales.min()) > 0
