import dataclasses
import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concealment.gaps import LAYOUT, random_context
from splatwire.concealment import Grow, concealer_names, create_concealer
from splatwire.concealment.sketch.concealer import SketchedLoss, buckets_of, conceal_with, sizes_of, with_sketch
from splatwire.concealment.sketch.section import (
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


def sketch_of_context(
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


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "share"), [(0, 0.2), (1, 0.0), (2, 1.0)])
def test_sketch_round_trips(seed: int, share: float) -> None:
    sketch, buckets = sketch_of_context(seed, share=share, trust=0.75), some_buckets()
    again = read_sketch(write_sketch(sketch, buckets), SIZES, buckets)
    for name in ("levels", "masks", "values", "offsets"):
        assert np.array_equal(getattr(again, name), getattr(sketch, name)), name
    assert (again.exponent, again.max_excess, again.trust) == (0.25, 1.5, 0.75)
    assert np.array_equal(
        again.basis.channels(np.array([2]), np.ones((1, 5))), sketch.basis.channels(np.array([2]), np.ones((1, 5)))
    )


def test_sketch_bytes_are_pinned() -> None:
    data = write_sketch(sketch_of_context(), some_buckets())
    assert (len(data), hashlib.sha256(data).hexdigest()[:16]) == (401, "53269dab933ab887")


def test_rare_levels_and_zeros_are_cheap() -> None:
    sketch = sketch_of_context(sizes=SketchSizes(20_000, 10, 4), share=0.0)
    assert len(write_sketch(sketch, some_buckets(SketchSizes(20_000, 10, 4)))) < 250


def test_buckets_are_by_rank_of_the_size() -> None:
    buckets = size_buckets(np.arange(1000.0))
    assert np.bincount(buckets).tolist() == [10, 20, 70, 150, 250, 500]
    assert buckets[-1] == 0
    assert size_buckets(np.zeros(0)).tolist() == []


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_hostile_bytes_raise_one_error_type(data: st.DataObject) -> None:
    buckets = some_buckets()
    good = bytearray(write_sketch(sketch_of_context(trust=1.0), buckets))
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


def test_invalid_arguments_are_named() -> None:
    buckets = some_buckets()
    good = write_sketch(sketch_of_context(), buckets)
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
    huge = dataclasses.replace(sketch_of_context(), values=sketch_of_context().values + (1 << 24))
    with pytest.raises(InvalidValueError, match="beyond the format"):
        write_sketch(huge, buckets)


def test_sketch_is_offered_only_with_its_section() -> None:
    assert "sketch" not in concealer_names()
    assert "sketch" in concealer_names([SECTION])
    with pytest.raises(InvalidValueError, match="needs the section 'sketch'"):
        create_concealer("sketch")(random_context(50, 0))


@pytest.mark.parametrize("separated", [False, True])
def test_received_attributes_override_the_sketch(separated: bool) -> None:
    context, sketch = random_context(200, 3, loss=0.5, separated=separated), sketch_of_context(4)
    context = dataclasses.replace(context, sections={SECTION: write_sketch(sketch, buckets_of(context))})
    proposal = create_concealer("sketch")(context)
    kept = context.elements.with_estimates(context.loss_mask, proposal.elements)
    for column, name in enumerate(("features", "scalings", "offsets", "mask")):
        there = context.loss_mask.received[:, column]
        assert np.array_equal(getattr(kept, name)[there], getattr(context.scene.anchors, name)[there])
    sketched = sketch.levels > 0
    assert np.array_equal(proposal.left_out, ~(context.loss_mask.fully_received | sketched))
    rows = sketched & ~context.loss_mask.received.any(axis=1)
    features = sketch.basis.channels(sketch.levels[sketched], sketch.values)[:, : LAYOUT.feature_dim]
    assert np.array_equal(kept.features[rows], features[rows[sketched]])
    assert bool((kept.scalings[rows] > 0).all())


def test_sketched_anchors_count_as_present() -> None:
    context, sketch = random_context(200, 5, loss=0.4), sketch_of_context(6, share=0.5)
    there = context.loss_mask.fully_received | sketch.levels > 0
    filled = with_sketch(context, sketch)
    assert np.array_equal(filled.loss_mask.fully_received, there)
    expected = Grow(exponent=0.25, max_excess=1.5)(filled).size_gain
    proposal = conceal_with(context, sketch)
    assert np.array_equal(proposal.size_gain, expected)
    assert bool((proposal.size_gain[~there] == 1).all())
    everyone = conceal_with(context, sketch_of_context(6, share=1.0))
    assert bool((everyone.size_gain == 1).all())
    assert not bool(everyone.left_out.any())


def test_network_corrects_gains_only_with_trust() -> None:
    context, plain, trusted = (
        random_context(200, 5, loss=0.4),
        sketch_of_context(6, share=0.3),
        sketch_of_context(6, share=0.3, trust=1.0),
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


def test_zero_trust_equals_plain_growth() -> None:
    context, sketch = random_context(200, 5, loss=0.4), sketch_of_context(6, share=0.3)
    grown, again = conceal_with(context, sketch), SketchedLoss.of(with_sketch(context, sketch)).conceal(sketch)
    assert np.allclose(grown.size_gain, again.size_gain, rtol=1e-6)
    assert bool((again.opacity_gain == 1).all())


@pytest.mark.parametrize("loss", [0.0, 0.99, 1.0])
def test_extreme_losses_give_finite_gains(loss: float) -> None:
    for share in (0.0, 0.01, 1.0):
        proposal = conceal_with(random_context(200, 8, loss=loss), sketch_of_context(9, share=share, trust=1.0))
        parts = [proposal.elements.features, proposal.elements.scalings, proposal.size_gain]
        parts += [] if proposal.opacity_gain is None else [proposal.opacity_gain]
        assert all(bool(np.isfinite(part).all()) for part in parts)


def test_sketch_sizes_follow_the_context() -> None:
    assert sizes_of(random_context(30, 0)) == SketchSizes(30, LAYOUT.feature_dim, LAYOUT.num_offsets)
