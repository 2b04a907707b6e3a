"""Previews round-trip, invalid ones are refused, and every accepted one can be rendered."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes import tiny_cameras
from splatwire.codec.preview import (
    BITS,
    MAX_DISTANCE_ASINH,
    MAX_GAUSSIANS,
    MAX_PREVIEW_BYTES,
    SIZES,
    Preview,
    PreviewQuantisation,
    gaussians_within,
    preview_gaussians,
    preview_scene,
    read_preview,
    write_preview,
)
from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.render.cpu import render_cpu
from splatwire.types import Gaussians

MAX_LEVELS = np.array([(1 << bits) - 1 for bits in BITS])
FRAME = PreviewQuantisation.fitting((0.1, -2.0, 3.0), 1.7, (-1.0, -0.5, 0.0, -5.0), (1.0, 0.7, 2.0, 0.5))


def preview_of(count: int, seed: int = 0) -> Preview:
    levels = np.random.default_rng(seed).integers(0, MAX_LEVELS + 1, (count, len(BITS)))
    return Preview(FRAME, (1, 20, 255), levels)


@settings(deadline=None)
@given(st.integers(1, MAX_GAUSSIANS), st.integers(0, 1000))
def test_preview_round_trips(count: int, seed: int) -> None:
    preview = preview_of(count, seed)
    data = write_preview(preview)
    back = read_preview(data)
    assert len(data) <= MAX_PREVIEW_BYTES
    assert (back.frame, back.background) == (preview.frame, preview.background)
    assert np.array_equal(back.levels, preview.levels)
    assert gaussians_within(len(data)) == count


def test_preview_values_are_within_half_a_step() -> None:
    low = np.array([*FRAME.low[:3], *FRAME.low[3:] * 3, 0, 0, 0, 1 / 32], np.float64)
    high = np.array([*FRAME.high[:3], *FRAME.high[3:] * 3, 1, 1, 1, 31 / 32], np.float64)
    values = low + (high - low) * np.random.default_rng(0).random((50, 10))
    sent = FRAME.values(FRAME.levels(values).round())
    assert bool((np.abs(sent - values) <= (high - low) / MAX_LEVELS / 2 + 1e-6).all())
    assert np.array_equal(FRAME.levels((low - 1)[None]).round()[0], np.zeros(10, np.float32).astype(np.float64))
    assert np.array_equal(FRAME.levels((high + 1)[None]).round()[0], MAX_LEVELS.astype(np.float64))


def test_preview_section_bytes_are_pinned() -> None:
    """A change of these bytes needs a new version of the section."""
    data = write_preview(Preview(FRAME, (1, 20, 255), np.array([[1, 2, 3, 4, 5, 6, 7, 8, 9, 10], MAX_LEVELS])))
    header = "01020114ff" + "cdcccc3d000000c000004040" + "9a99d93f" + "000080bf000000bf000000000000a0c0"
    assert data.hex() == header + "0000803f3333333f000000400000003f" + "010203214c7426bf" + "ff" * 6 + "f0"
    gaussians, background = preview_gaussians(data)
    assert background == (1 / 255, 20 / 255, 1.0)
    assert gaussians.opacities.tolist() == [21 / 32, 31 / 32]
    assert gaussians.colors[1].tolist() == [1, 1, 1]
    expected = 0.1 + 1.7 * np.sinh(1.0)
    assert gaussians.means[1, 0].item() == pytest.approx(expected)


@pytest.mark.parametrize("count", [1, 7, MAX_GAUSSIANS])
def test_truncated_and_extended_previews_are_refused(count: int) -> None:
    data = write_preview(preview_of(count))
    for size in range(len(data)):
        with pytest.raises(BitstreamError):
            read_preview(data[:size])
    for bad in (data + b"\0", data + bytes(MAX_PREVIEW_BYTES)):
        with pytest.raises(BitstreamError, match="preview: "):
            read_preview(bad)


def test_errors_name_the_invalid_field() -> None:
    data = bytearray(write_preview(preview_of(3)))
    for place, value, message in (
        (0, b"\x02", "version 2"),
        (1, b"\0", "1 to 133 Gaussians"),
        (5, np.float32("nan").tobytes(), "middle"),
        (17, np.float32(0).tobytes(), "spread"),
        (21, np.float32(-9).tobytes(), "range of x"),
        (49, np.float32(-6).tobytes(), "range of sizes"),
        (len(data) - 1, bytes([data[-1] | 1]), "bits behind"),
    ):
        bad = bytes(data[:place]) + value + bytes(data[place + len(value) :])
        bad = bad[:53] if place == 1 else bad
        with pytest.raises(UnsupportedVersionError if place == 0 else BitstreamError, match=message):
            read_preview(bad)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=1100) | st.integers(0, 200).map(lambda n: bytes([1, n])).flatmap(
    lambda head: st.binary(min_size=0, max_size=1100).map(lambda rest: head + rest)))  # fmt: skip
def test_arbitrary_bytes_give_a_preview_or_an_error(data: bytes) -> None:
    try:
        gaussians, background = preview_gaussians(data)
    except BitstreamError:
        return
    check(gaussians)
    assert all(0 <= value <= 1 for value in background)


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_flipped_bytes_give_a_drawable_preview_or_an_error(data: st.DataObject) -> None:
    good = bytearray(write_preview(preview_of(5)))
    for _ in range(data.draw(st.integers(1, 4))):
        good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    try:
        gaussians, _ = preview_gaussians(bytes(good))
    except BitstreamError:
        return
    check(gaussians)


def check(gaussians: Gaussians) -> None:
    fields = [getattr(gaussians, field.name) for field in dataclasses.fields(gaussians)]
    assert all(bool(np.isfinite(values).all()) and values.dtype == np.float32 for values in fields)
    assert bool((gaussians.scales > 0).all())
    camera = tiny_cameras(num_views=1, width=16, height=12)
    assert render_cpu(gaussians, camera, background=np.zeros(3, np.float32)).shape == (1, 12, 16, 3)


def test_preview_of_explicit_gaussians_renders_like_the_gaussians() -> None:
    data, camera = write_preview(preview_of(20)), tiny_cameras(num_views=1, width=32, height=24)
    (gaussians, background), scene = preview_gaussians(data), preview_scene(data)
    assert background == scene.background
    splats = scene.splats
    pictures = [
        render_cpu(g, camera, background=np.zeros(3, np.float32))
        for g in (gaussians, splats.seen_from(np.zeros(3, np.float32)))
    ]
    assert bool(np.abs(pictures[0] - pictures[1]).max() < 1e-5)


def test_preview_with_extreme_values_renders() -> None:
    rng = np.random.default_rng(0)
    for spread in (2.0**-20, 1.0, 2.0**20):
        frame = PreviewQuantisation(
            (2.0**20, -(2.0**20), 0.0),
            spread,
            (*[-MAX_DISTANCE_ASINH] * 3, SIZES[0]),
            (*[MAX_DISTANCE_ASINH] * 3, SIZES[1]),
        )
        check(Preview(frame, (0, 0, 0), rng.integers(0, MAX_LEVELS + 1, (MAX_GAUSSIANS, len(BITS)))).gaussians())


def test_oversized_preview_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="1 to 133"):
        preview_of(MAX_GAUSSIANS + 1)
    with pytest.raises(InvalidValueError, match="fit its bits"):
        Preview(FRAME, (0, 0, 0), np.full((1, 10), 256))
    with pytest.raises(InvalidValueError, match="spread"):
        PreviewQuantisation.fitting((0.0,) * 3, 0.0, (0.0,) * 4, (0.0,) * 4)
    assert gaussians_within(0) == gaussians_within(60) == 0
    assert gaussians_within(10**6) == MAX_GAUSSIANS == 133
