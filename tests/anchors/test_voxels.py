import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatwire.anchors.voxels import MAX_VOXEL_INDEX, voxel_indices, voxel_positions
from splatwire.errors import InvalidValueError

INDICES = st.lists(st.tuples(*[st.integers(-MAX_VOXEL_INDEX, MAX_VOXEL_INDEX)] * 3), min_size=1, max_size=20)


@settings(deadline=None)
@given(INDICES, st.floats(1e-6, 1e3))
def test_voxel_indices_round_trip_through_positions(indices, voxel_size):
    indices = np.array(indices)
    assert np.array_equal(voxel_indices(voxel_positions(indices, voxel_size), voxel_size), indices)


@settings(deadline=None)
@given(INDICES, st.floats(1e-6, 1e3))
def test_positions_of_a_float32_product_have_the_same_indices(indices, voxel_size):
    indices = np.array(indices)
    assert np.array_equal(voxel_indices(indices.astype(np.float32) * voxel_size, voxel_size), indices)


def test_position_is_the_nearest_float32_to_the_product():
    assert voxel_positions(np.array([[3, -7, 12345]]), 0.001).tolist() == [
        [0.003000000026077032, -0.007000000216066837, 12.345000267028809]
    ]


@pytest.mark.parametrize("position", [0.0015, 0.00101, float("nan"), float("inf"), 0.001 * (MAX_VOXEL_INDEX + 10)])
def test_positions_off_the_voxel_grid_are_refused(position):
    with pytest.raises(InvalidValueError):
        voxel_indices(np.array([[0.0, 0.001, 0.002], [position, 0.0, 0.0]], np.float32), 0.001)


@settings(deadline=None)
@given(INDICES, st.floats(1e-6, 1e3), st.floats(3.0, 1e12))
def test_a_voxel_size_far_too_large_is_refused(indices, voxel_size, factor):
    """Every position would be within a small share of voxel 0, which only 0 itself should occupy."""
    positions = voxel_positions(np.array([*indices, (1, 0, 0)]), voxel_size)
    with pytest.raises(InvalidValueError, match="not whole multiples"):
        voxel_indices(positions, float(np.abs(positions).max()) * factor)


@pytest.mark.parametrize("voxel_size", [0.0, -1.0, float("nan"), float("inf")])
def test_a_voxel_size_must_be_positive(voxel_size):
    with pytest.raises(InvalidValueError, match="voxel size"):
        voxel_indices(np.zeros((1, 3), np.float32), voxel_size)


def test_the_message_names_the_first_wrong_anchor():
    with pytest.raises(InvalidValueError, match=r"1 of 2 .* anchor 1 at \[0\.5"):
        voxel_indices(np.array([[1.0, 2.0, 3.0], [0.5, 0.0, 0.0]], np.float32), 1.0)
