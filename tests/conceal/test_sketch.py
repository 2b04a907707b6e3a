import dataclasses
import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conceal.gaps import LAYOUT, random_context
from splatwire.conceal import Grow, concealer_names, create_concealer
from splatwire.conceal.sketch.concealer import SketchedLoss, buckets_of, conceal_with, sizes_of, with_sketch
from splatwire.conceal.sketch.section import (
    SECTION,
    SketchBasis,
    SketchSection,
    SketchSizes,
    read_sketch,
    size_buckets,
    write_sketch,
)
from splatwire.errors import BitstreamError, InvalidValueError, TruncatedStreamError, UnsupportedVersionError

SIZES = SketchSizes(200, LAYOUT.feature_dim, LAYOUT.num_offsets)


def a_sketch(
    seed: int = 0, sizes: SketchSizes = SIZES, columns: int = 5, share: float = 0.2, trust: float = 0.0
) -> SketchSection:
    rng = np.random.default_rng(seed)
    levels = np.where(rng.random(sizes.num_anchors) < share, rng.integers(1, 4, sizes.num_anchors), 0)
    count = int((levels > 0).sum())
    masks = (rng.random((count, sizes.num_offsets)) < 0.5).astype(np.uint8)
    basis = SketchBasis(
        rng.normal(size=sizes.num_channels).astype(np.float16).astype(np.float32),
        rng.integers(-127, 128, (sizes.num_channels, columns)).astype(np.int16),
        rng.random(columns).astype(np.float16).astype(np.float32) / 128,
        0.5, 3,
    )  # fmt: skip
    values = np.rint(rng.standard_cauchy((count, columns))).astype(np.int64).clip(-100_000, 100_000)
    offsets = np.rint(rng.normal(0, 3, (count, 3 * sizes.num_offsets))).astype(np.int64) * np.repeat(masks, 3, axis=1)
    return SketchSection(0.25, 1.5, trust, basis, levels, masks, values, offsets)


def some_buckets(sizes: SketchSizes = SIZES) -> np.ndarray:
    return size_buckets(np.random.default_rng(7).random(sizes.num_anchors))


@pytest.mark.parametrize(("seed", "share"), [(0, 0.2), (1, 0.0), (2, 1.0)])
def test_what_is_written_is_read(seed: int, share: float) -> None:
    sketch, buckets = a_sketch(seed, share=share, trust=0.75), some_buckets()
    again = read_sketch(write_sketch(sketch, buckets), SIZES, buckets)
    for name in ("levels", "masks", "values", "offsets"):
        assert np.array_equal(getattr(again, name), getattr(sketch, name)), name
    assert (again.exponent, again.max_excess, again.trust) == (0.25, 1.5, 0.75)
    assert np.array_equal(
        again.basis.channels(np.array([2]), np.ones((1, 5))), sketch.basis.channels(np.array([2]), np.ones((1, 5)))
    )


def test_bytes_are_pinned() -> None:
    data = write_sketch(a_sketch(), some_buckets())
    assert (len(data), hashlib.sha256(data).hexdigest()[:16]) == (401, "53269dab933ab887")


def test_rare_levels_and_zeros_are_cheap() -> None:
    sketch = a_sketch(sizes=SketchSizes(20_000, 10, 4), share=0.0)
    assert len(write_sketch(sketch, some_buckets(SketchSizes(20_000, 10, 4)))) < 250


def test_buckets_are_by_rank_of_the_size() -> None:
    buckets = size_buckets(np.arange(1000.0))
    assert np.bincount(buckets).tolist() == [10, 20, 70, 150, 250, 500]
    assert buckets[-1] == 0
    assert size_buckets(np.zeros(0)).tolist() == []


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_hostile_bytes_give_one_kind_of_error(data: st.DataObject) -> None:
    buckets = some_buckets()
    good = bytearray(write_sketch(a_sketch(trust=1.0), buckets))
    for _ in range(data.draw(st.integers(1, 4))):
        good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(good)))
    try:
        read = read_sketch(bytes(good[:cut]), SIZES, buckets)
    except BitstreamError:
        return
    context = random_context(200, 0)
    proposal = conceal_with(context, read)
    drawn = proposal.elements
    for part in (drawn.features, drawn.scalings, drawn.offsets, proposal.size_gain):
        assert bool(np.isfinite(part).all())


def test_mistakes_are_named() -> None:
    buckets = some_buckets()
    good = write_sketch(a_sketch(), buckets)
    for version in (1, 9):
        with pytest.raises(UnsupportedVersionError, match=f"version {version}.*make it again"):
            read_sketch(bytes([version]) + good[1:], SIZES, buckets)
    for trust in (-0.5, 5.0, float("nan")):
        impossible = good[:24] + np.float32(trust).tobytes() + good[28:]
        with pytest.raises(BitstreamError, match="impossible"):
            read_sketch(impossible, SIZES, buckets)
    for cut in (0, 10, 60):
        with pytest.raises(TruncatedStreamError):
            read_sketch(good[:cut], SIZES, buckets)
    other = dataclasses.replace(SIZES, num_anchors=201)
    with pytest.raises(BitstreamError, match="of a scene of 200 anchors"):
        read_sketch(good, other, some_buckets(other))
    with pytest.raises(BitstreamError, match="sketched, and"):
        read_sketch(good[:8] + bytes([good[8] + 1]) + good[9:], SIZES, buckets)
    huge = dataclasses.replace(a_sketch(), values=a_sketch().values + (1 << 24))
    with pytest.raises(InvalidValueError, match="beyond the format"):
        write_sketch(huge, buckets)


def test_it_is_listed_only_where_there_is_a_section() -> None:
    assert "sketch" not in concealer_names()
    assert "sketch" in concealer_names([SECTION])
    with pytest.raises(InvalidValueError, match="needs the section 'sketch'"):
        create_concealer("sketch")(random_context(50, 0))


@pytest.mark.parametrize("separated", [False, True])
def test_received_attributes_win_and_the_rest_is_left_out(separated: bool) -> None:
    context, sketch = random_context(200, 3, loss=0.5, separated=separated), a_sketch(4)
    context = dataclasses.replace(context, sections={SECTION: write_sketch(sketch, buckets_of(context))})
    proposal = create_concealer("sketch")(context)
    kept = context.elements.kept(context.erasures, proposal.elements)
    for column, name in enumerate(("features", "scalings", "offsets", "mask")):
        there = context.erasures.received[:, column]
        assert np.array_equal(getattr(kept, name)[there], getattr(context.scene.anchors, name)[there])
    sketched = sketch.levels > 0
    assert np.array_equal(proposal.left_out, ~(context.erasures.known | sketched))
    rows = sketched & ~context.erasures.received.any(axis=1)
    features = sketch.basis.channels(sketch.levels[sketched], sketch.values)[:, : LAYOUT.feature_dim]
    assert np.array_equal(kept.features[rows], features[rows[sketched]])
    assert bool((kept.scalings[rows] > 0).all())


def test_sketched_anchors_count_as_present() -> None:
    context, sketch = random_context(200, 5, loss=0.4), a_sketch(6, share=0.5)
    there = context.erasures.known | sketch.levels > 0
    filled = with_sketch(context, sketch)
    assert np.array_equal(filled.erasures.known, there)
    expected = Grow(exponent=0.25, max_excess=1.5)(filled).size_gain
    proposal = conceal_with(context, sketch)
    assert np.array_equal(proposal.size_gain, expected)
    assert bool((proposal.size_gain[~there] == 1).all())
    everyone = conceal_with(context, a_sketch(6, share=1.0))
    assert bool((everyone.size_gain == 1).all())
    assert not bool(everyone.left_out.any())


def test_the_network_corrects_the_growth_as_far_as_it_is_trusted() -> None:
    context, plain, trusted = (
        random_context(200, 5, loss=0.4),
        a_sketch(6, share=0.3),
        a_sketch(6, share=0.3, trust=1.0),
    )
    grown, corrected = conceal_with(context, plain), conceal_with(context, trusted)
    assert grown.opacity_gain is None
    assert corrected.opacity_gain is not None
    drawn = ~grown.left_out
    ratio = corrected.size_gain / grown.size_gain
    for gain in (ratio, corrected.opacity_gain):
        assert bool((gain[drawn] != 1).any())
        assert bool((gain[~drawn] == 1).all())
        assert float(np.abs(np.log(gain)).max()) <= 0.3 + 1e-6
    assert np.array_equal(corrected.left_out, grown.left_out)
    assert np.array_equal(corrected.elements.features, grown.elements.features)


def test_without_trust_both_ways_to_the_growth_agree() -> None:
    context, sketch = random_context(200, 5, loss=0.4), a_sketch(6, share=0.3)
    grown, again = conceal_with(context, sketch), SketchedLoss.of(with_sketch(context, sketch)).proposal(sketch)
    assert np.allclose(grown.size_gain, again.size_gain, rtol=1e-6)
    assert bool((again.opacity_gain == 1).all())


@pytest.mark.parametrize("loss", [0.0, 0.99, 1.0])
def test_extreme_losses_stay_finite(loss: float) -> None:
    for share in (0.0, 0.01, 1.0):
        proposal = conceal_with(random_context(200, 8, loss=loss), a_sketch(9, share=share, trust=1.0))
        parts = [proposal.elements.features, proposal.elements.scalings, proposal.size_gain]
        parts += [] if proposal.opacity_gain is None else [proposal.opacity_gain]
        assert all(bool(np.isfinite(part).all()) for part in parts)


def test_sizes_of_a_context() -> None:
    assert sizes_of(random_context(30, 0)) == SketchSizes(30, LAYOUT.feature_dim, LAYOUT.num_offsets)
