"""The kernels that prepare the encoder's input equal their references of whole arrays."""

import numpy as np
import pytest

from reference.gaussian_sources import reference_axes, reference_centres, reference_colours, reference_logs
from splatwire.codec.gaussians import _source_kernels as kernels
from splatwire.codec.gaussians.attributes import to_sources
from splatwire.codec.gaussians.blocks import block_codes, to_lattice
from splatwire.ops.morton import morton_encode
from splatwire.types.splats import Splats


def gaussians(count: int, seed: int = 0) -> Splats:
    """Gaussians of all shapes: equal scales, flat ones, points, quaternions of any length, extreme colours."""
    rng = np.random.default_rng(seed)
    scales = 2.0 ** rng.integers(-30, 12, (count, 3)) * rng.choice([1.0, 1.7], (count, 3))
    opacities = np.concatenate([[1.0, 1e-9], rng.uniform(1e-4, 1, count - 2)])
    arrays = (rng.normal(size=(count, 3)) * 9, rng.normal(size=(count, 4)) * 3, scales, opacities)
    sh = rng.normal(size=(count, 4, 3)) * rng.choice([1.0, 900.0], (count, 1, 1))
    return Splats(*(values.astype(np.float32) for values in (*arrays, sh)))


def read_only(splats: Splats) -> Splats:
    """The same Gaussians in arrays of column order that cannot be written."""
    arrays = {name: np.asfortranarray(values) for name, values in vars(splats).items()}
    for values in arrays.values():
        values.flags.writeable = False
    return Splats(**arrays)


@pytest.mark.parametrize("size_log", [-7, 0, 5])
def test_sources_equal_their_reference(size_log: int) -> None:
    splats = gaussians(500)
    for some in (splats, read_only(splats)):
        found = to_sources(some, size_log)
        np.testing.assert_array_equal(found.logs, reference_logs(splats, size_log))
        np.testing.assert_allclose(found.axes, reference_axes(splats), rtol=0, atol=1e-15)
        # A product of matrices may add in another order, which changes the rounding of one of many numbers.
        assert np.abs(found.colours - reference_colours(splats)).max() <= 1
        assert (found.colours == reference_colours(splats)).mean() > 0.999


def test_places_equal_the_lattice() -> None:
    means = gaussians(500).means
    found = np.empty(means.shape, np.int64)
    most = kernels.write_places(means, 2.0**7, found)
    np.testing.assert_array_equal(found, to_lattice(means.astype(np.float64), 9, 2))
    assert most == np.abs(found).max()


@pytest.mark.parametrize("bits", [1, 9, 21, 30])
def test_codes_of_blocks_equal_morton_codes(bits: int) -> None:
    places = np.random.default_rng(bits).integers(0, 1 << bits, (300, 3))
    places[0], places[1] = 0, (1 << bits) - 1
    np.testing.assert_array_equal(block_codes(places, bits), morton_encode(places >> max(bits - 21, 0)))


def test_codes_refuse_positions_outside_the_box() -> None:
    for wrong in (-1, 1 << 21):
        with pytest.raises(ValueError, match="must be in"):
            block_codes(np.array([[0, 1, 2], [3, 4, wrong]]), 21)


def test_centres_of_cells_equal_their_reference() -> None:
    means, shifts = gaussians(500).means, np.random.default_rng(1).integers(0, 20, 500)
    found = means.copy()
    kernels.snap_to_cells(found, shifts, 2.0**20, 2.0**-21)
    np.testing.assert_array_equal(found, reference_centres(means, shifts, 22, 2))
