"""Bounding ball of a clip."""

import numpy as np
import pytest

from random_numbers import Numbers
from splatwire.bitstream.sections import sections_of
from splatwire.codec.initial_view import EXTENT_SECTION, extent_section, read_extent
from splatwire.errors import BitstreamError
from splatwire.sequence import SequenceEncoder
from splatwire.sequence.extent import BoundingSphere, bounding_sphere
from splatwire.types.splats import Splats


def cloud(count: int, shift: float, size: float) -> Splats:
    means = Numbers(3).randn(count, 3) * size
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (count, 1))
    moved = means + np.array([shift, 0.0, 0.0], np.float32)
    return Splats(
        moved,
        quats,
        np.full((count, 3), 0.01, np.float32),
        np.full((count,), 0.9, np.float32),
        np.zeros((count, 1, 3), np.float32),
    )


def test_union_of_two_spheres_is_the_smallest_enclosing_sphere():
    rng = np.random.default_rng(5)
    for _ in range(50):
        one, other = (BoundingSphere(rng.normal(size=3), float(rng.uniform(0.1, 2))) for _ in range(2))
        both = one.union(other)
        apart = float(np.linalg.norm(one.middle - other.middle))
        for ball in (one, other):
            assert np.linalg.norm(both.middle - ball.middle) + ball.radius <= both.radius + 1e-9
        assert both.radius <= max(one.radius, other.radius, (apart + one.radius + other.radius) / 2) + 1e-9


def test_far_and_faint_gaussians_do_not_extend_the_sphere():
    splats = cloud(1000, 0.0, 1.0)
    alone = bounding_sphere(splats)
    splats.means[0] = 1000.0
    splats.means[1:300] += 50.0
    splats.opacities[1:300] = 0.01
    found = bounding_sphere(splats)
    assert alone is not None
    assert found is not None
    assert found.radius < 1.3 * alone.radius
    assert bounding_sphere(cloud(0, 0.0, 1.0)) is None


def test_stream_contains_the_extent_of_its_clip():
    encoder = SequenceEncoder()
    frames = [cloud(200, shift, 0.2) for shift in (0.0, 1.0, 2.0, 3.0)]
    for frame in frames:
        encoder.push(frame)
    said = read_extent(sections_of(encoder.finish()))
    assert said is not None
    middle, radius = np.array(said[0]), said[1]
    inside = np.stack(
        [(np.linalg.norm(frame.means - middle, axis=1) <= radius).astype(np.float32).mean() for frame in frames]
    )
    assert bool((inside > 0.95).all())
    assert 1.5 < radius < 3.0


@pytest.mark.parametrize("bad", [b"", bytes(16), extent_section((0.0, 0.0, 0.0), float("nan")), bytes(17)])
def test_an_impossible_extent_is_refused(bad: bytes):
    with pytest.raises(BitstreamError, match="extent"):
        read_extent({EXTENT_SECTION: bad})
