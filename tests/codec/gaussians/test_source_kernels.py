"""The kernels that prepare the encoder's input equal their references of whole arrays."""

from collections.abc import Callable

import numpy as np
import pytest
from numba import njit

from reference.gaussian_sources import (
    reference_arrangement,
    reference_axes,
    reference_centres,
    reference_colours,
    reference_extent,
    reference_logs,
    reference_means,
)
from splatwire.bitstream import PRESETS, PacketPlan
from splatwire.codec.gaussians import _source_kernels as kernels
from splatwire.codec.gaussians.attributes import LUMA_CHROMA, to_harmonics, to_sources, transform_harmonics
from splatwire.codec.gaussians.blocks import block_codes, to_lattice
from splatwire.codec.gaussians.encoder import fit_side_info
from splatwire.codec.gaussians.layout import MAX_COLOUR, STEP_HARMONICS
from splatwire.codec.gaussians.quality import QUALITIES, Quality
from splatwire.codec.gaussians.side_info import MEAN_SHIFT
from splatwire.codec.gaussians.source_scene import SourceScene
from splatwire.ops.morton import morton_encode
from splatwire.ops.prefetch import prefetch
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


def test_coordinates_of_blocks_equal_the_lattice() -> None:
    means, corner = gaussians(500).means, np.array([-5000, -6000, -7000])
    indices = np.random.default_rng(4).permutation(500).astype(np.uint32)
    coords, codes = np.empty(means.shape, np.int64), np.empty(500, np.int64)
    most, used = kernels.write_block_positions(indices, means, 2.0**7, corner, 3, coords, codes)
    lattice = to_lattice(means[indices].astype(np.float64), 9, 2)
    np.testing.assert_array_equal(coords, lattice - corner)
    np.testing.assert_array_equal(codes, morton_encode((lattice - corner) >> 3))
    assert most == np.abs(lattice).max()
    assert used == np.bitwise_or.reduce((lattice - corner) >> 3, axis=None)


@pytest.mark.parametrize("bits", [1, 9, 21, 30])
def test_codes_of_blocks_equal_morton_codes(bits: int) -> None:
    coords = np.random.default_rng(bits).integers(0, 1 << bits, (300, 3))
    coords[0], coords[1] = 0, (1 << bits) - 1
    np.testing.assert_array_equal(block_codes(coords, bits), morton_encode(coords >> max(bits - 21, 0)))


def test_codes_refuse_positions_outside_the_box() -> None:
    for wrong in (-1, 1 << 21):
        with pytest.raises(ValueError, match="must be in"):
            block_codes(np.array([[0, 1, 2], [3, 4, wrong]]), 21)


def test_rounded_positions_equal_their_reference() -> None:
    means, shifts = gaussians(500).means, np.random.default_rng(1).integers(0, 20, 500)
    found = means.copy()
    kernels.round_positions(found, shifts, 2.0**20, 2.0**-21)
    np.testing.assert_array_equal(found, reference_centres(means, shifts, 22, 2))


@pytest.mark.parametrize("contiguous", [False, True])
@pytest.mark.parametrize("bits", [0, 3, 8, 22, 63])
def test_the_order_of_cells_equals_its_reference(bits: int, contiguous: bool) -> None:
    rng = np.random.default_rng(bits)
    codes = rng.integers(0, 1 << bits, 700) if bits < 63 else rng.integers(0, np.iinfo(np.int64).max, 700)
    codes[100:300] = codes[:200]  # equal codes keep their order
    for shift in (0, 3):
        found = kernels.sort_cells(codes, shift, contiguous)
        np.testing.assert_array_equal(found, reference_arrangement(codes >> shift, contiguous))


def test_extents_of_groups_equal_their_reference() -> None:
    rng = np.random.default_rng(3)
    sizes = [1, 2, 49, 50, 51, 52, 700, 700]
    edges = np.cumsum([0, *sizes])
    positions = (rng.normal(size=(edges[-1], 3)) * 2.0 ** rng.integers(0, 38, (edges[-1], 1))).astype(np.int64)
    positions[-700:] = 5
    expected = [reference_extent(part) for part in np.split(positions, edges[1:-1])]
    np.testing.assert_array_equal(kernels.extents(positions, edges), expected)


def test_harmonics_equal_their_reference() -> None:
    splats = gaussians(300)
    expected = np.clip(splats.sh[:, 1:].astype(np.float64) @ (LUMA_CHROMA.T * 4096), -MAX_COLOUR, MAX_COLOUR)
    for some in (splats, read_only(splats)):
        np.testing.assert_allclose(to_harmonics(some), expected, rtol=1e-12, atol=1e-9)


def scene_of(splats: Splats, quality: Quality) -> SourceScene:
    classes = np.random.default_rng(1).integers(-5, 1, splats.num_gaussians)
    return SourceScene.of(splats, PacketPlan(PRESETS["datagram"], splats.num_gaussians), classes, None, quality)


@pytest.mark.parametrize("layout", [lambda splats: splats, read_only], ids=["rows", "columns"])
def test_summaries_of_blocks_equal_their_reference(layout: Callable[[Splats], Splats]) -> None:
    splats = gaussians(5000)
    scene = scene_of(layout(splats), QUALITIES["default"])
    assert scene.num_blocks > 1
    for block in range(scene.num_blocks):
        members, (bounds, means) = scene.order[scene.block_range(block)], scene.summary(block)
        places = to_lattice(scene.centres[members].astype(np.float64), scene.lattice_bits, scene.size_log)
        np.testing.assert_array_equal(bounds, [places.min(axis=0), places.max(axis=0)])
        expected = reference_means(scene.splats.select(members), scene.size_log)
        assert np.abs(means - expected).max() <= (0.5 + 1e-3) * (1 << MEAN_SHIFT)
        assert not (means % (1 << MEAN_SHIFT)).any()


@pytest.mark.parametrize("layout", [lambda splats: splats, read_only], ids=["rows", "columns"])
@pytest.mark.parametrize("level", [2.0, 8.0, 20.0])
def test_arranged_gaussians_equal_their_reference(level: float, layout: Callable[[Splats], Splats]) -> None:
    splats = gaussians(700, seed=2)
    splats.sh[::5] *= 1e-3
    quality = Quality(level=level)
    scene = scene_of(layout(splats), quality)
    info = fit_side_info(scene, {}, None, None, 1)
    found = scene.block_source(0, info)
    positions = to_lattice(scene.centres.astype(np.float64), scene.lattice_bits, scene.size_log)[scene.order]
    positions -= info.boxes.corners[0]
    bits = int(info.boxes.bits[0])
    codes = block_codes(positions, bits)
    by = reference_arrangement(codes >> 3 * (int(found.cell_shift) - max(bits - 21, 0)), contiguous=False)
    np.testing.assert_array_equal(found.positions, positions[by])
    np.testing.assert_array_equal(found.codes, codes[by])
    members = scene.order[by]
    np.testing.assert_array_equal(found.precision_classes, scene.precision_classes[members])
    expected = to_sources(scene.splats.select(members), scene.size_log)
    for name, values in vars(expected).items():
        np.testing.assert_array_equal(getattr(found, name), values)
    harmonics = transform_harmonics(scene.splats.select(members), info.transform)
    exponents = (info.base_exponents[STEP_HARMONICS] + 64 * found.precision_classes + 32) >> 6
    shifts = np.clip(12 - exponents, 0, 10)[:, None]
    rounded = [(values + ((1 << shifts) >> 1)) >> shifts for values in (harmonics.astype(np.int64), found.harmonics)]
    assert np.abs(rounded[0] - rounded[1]).max() <= 1
    assert (rounded[0] == rounded[1]).mean() > 0.999
    left_out = (found.harmonics == 0).all(axis=1) & (harmonics != 0).any(axis=1)  # those far below a step
    assert left_out.any() == (level < 20)


def test_prefetching_changes_nothing() -> None:
    values = np.arange(12.0).reshape(4, 3)
    assert prefetch(values, np.int64(0), np.int64(0)) is None

    @njit
    def total(array: np.ndarray) -> float:
        result = 0.0
        for row in range(len(array)):
            prefetch(array, np.int64(min(row + 2, 3)), np.int64(0))
            result += array[row, 0]
        return result

    assert total(values) == values[:, 0].sum()
