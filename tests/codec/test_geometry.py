import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatwire.codec.geometry import CORNER_ALIGNMENT, anchor_order, decode_positions, encode_positions
from splatwire.errors import BitstreamError, SplatwireError
from splatwire.ops.morton import morton_decode, morton_encode


def cloud(rng: np.random.Generator, n: int, spread: int, grid: int) -> np.ndarray:
    return rng.integers(-spread, spread + 1, (n, 3)) // grid * grid


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32), n=st.integers(0, 300), bits=st.integers(0, 19), grid=st.sampled_from([1, 4, 16]),
    order=st.sampled_from(["morton", "raster"]),
)  # fmt: skip
def test_positions_round_trip_in_order(seed: int, n: int, bits: int, grid: int, order: str) -> None:
    voxels = cloud(np.random.default_rng(seed), n, 1 << bits, grid)  # small spreads repeat points
    decoded = decode_positions(encode_positions(voxels), n, order)
    assert (decoded == voxels[anchor_order(voxels, order)]).all()


def test_morton_order_is_the_interleaved_order() -> None:
    rng = np.random.default_rng(0)
    points = rng.integers(0, 1 << 21, (500, 3))
    codes = morton_encode(points)
    for point, code in zip(points.tolist(), codes.tolist(), strict=True):
        assert code == sum(((point[a] >> i) & 1) << (3 * i + a) for i in range(21) for a in range(3))
    assert (morton_decode(codes) == points).all()


def test_morton_blocks_are_compact_and_raster_blocks_are_slabs() -> None:
    voxels = cloud(np.random.default_rng(1), 8000, 60, 1)
    extents = {}
    for order in ("morton", "raster"):
        ordered = voxels[anchor_order(voxels, order)]
        blocks = [ordered[i : i + 1000] for i in range(0, 8000, 1000)]
        extents[order] = np.mean([np.ptp(b, axis=0) for b in blocks], axis=0)
    assert extents["raster"][2] < extents["morton"][2] / 2
    assert extents["raster"][:2].min() > extents["morton"].max() - 1


def test_anchors_on_a_coarse_grid_cost_fewer_bits() -> None:
    rng = np.random.default_rng(2)
    fine = cloud(rng, 4000, 1 << 14, 1)
    coarse = fine // 16 * 16
    saved = len(encode_positions(fine)) - len(encode_positions(coarse))
    assert saved * 8 > 0.9 * 12 * len(fine)


def test_corner_is_aligned() -> None:
    voxels = np.array([[5000, -3, 77], [5001, -2, 78]])
    assert decode_positions(encode_positions(voxels), 2, "morton").tolist() == voxels.tolist()
    assert CORNER_ALIGNMENT % 16 == 0


def test_points_too_far_apart_are_refused() -> None:
    with pytest.raises(ValueError, match="Morton"):
        encode_positions(np.array([[0, 0, 0], [1 << 22, 0, 0]]))


def test_excessive_counts_are_refused_before_allocation() -> None:
    data = encode_positions(cloud(np.random.default_rng(3), 100, 50, 1))
    with pytest.raises(BitstreamError, match="cannot hold"):
        decode_positions(data, 1 << 27, "morton")


@settings(max_examples=300, deadline=None)
@given(data=st.binary(max_size=80), count=st.integers(0, 600))
def test_arbitrary_bytes_are_points_or_an_error(data: bytes, count: int) -> None:
    try:
        voxels = decode_positions(data, count, "morton")
    except SplatwireError:
        return
    assert voxels.shape == (count, 3)


def test_coded_positions_are_pinned() -> None:
    voxels = np.array([[0, 0, 0], [16, -32, 48], [16, -32, 48], [1000, 1000, -1000], [7, 8, 9]])
    assert encode_positions(voxels).hex() == "00ff0fff0f2119b6dce0020410411444000000000000000800851d"
