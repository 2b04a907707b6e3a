"""Positions that a caller makes keep their precision, or an error says how."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from splat_io.formats.handmade import some_splats
from splatwire.errors import InvalidValueError
from splatwire.sequence.frames import Frame
from splatwire.types import Anchors, Gaussians, SplatScene
from splatwire.types.shapes import check_arrays
from splatwire.types.splats import Splats

UTM = np.array([451234.0, 5411876.0, 118.0])


def far_means(count: int = 20) -> np.ndarray:
    return np.asarray(some_splats(count, 0).means.astype(np.float64) + UTM)


def test_float64_positions_far_from_zero_are_refused_with_the_way_to_an_origin() -> None:
    splats, means = some_splats(20, 0), far_means()
    with pytest.raises(InvalidValueError, match=r"Splats.means: float64 coordinates up to 5.41188e\+06.*steps of 0.5"):
        replace(splats, means=means)
    with pytest.raises(InvalidValueError, match=r"Gaussians.means: float64"):
        Gaussians(means, splats.quats, splats.scales, splats.opacities, splats.sh[:, 0])
    with pytest.raises(InvalidValueError, match=r"Anchors.positions: .*float64"):
        Anchors(
            torch.from_numpy(means), torch.zeros(20, 4), torch.ones(20, 6), torch.zeros(20, 2, 3),
            torch.ones(20, 2, dtype=torch.bool),
        )  # fmt: skip
    with pytest.raises(InvalidValueError, match="origin=origin"):
        Frame.of(replace(splats, means=means))


def test_conversion_that_the_error_suggests_keeps_positions_exactly() -> None:
    means = far_means()
    origin = tuple(np.median(means, axis=0).round().tolist())
    near = replace(some_splats(20, 0), means=(means - origin).astype(np.float32))
    scene = SplatScene(near, origin=origin)
    assert np.abs(scene.splats.means.astype(np.float64) + np.array(scene.origin) - means).max() < 1e-6


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.float16])
def test_positions_near_zero_pass_in_any_precision(dtype: type[np.floating]) -> None:
    splats = some_splats(20, 0)
    means = splats.means.astype(dtype)
    means[3] = np.nan
    assert isinstance(replace(splats, means=means), Splats)


def test_coordinates_beyond_any_map_are_refused() -> None:
    splats = some_splats(20, 0)
    with pytest.raises(InvalidValueError, match=r"around 1e\+13 from 0"):
        replace(splats, means=np.full((20, 3), 1e13))


@pytest.mark.skipif(np.dtype(np.longdouble) == np.float64, reason="longdouble is float64 on this machine")
def test_arrays_of_extended_precision_are_refused() -> None:
    record = SimpleNamespace(scales=np.ones((20, 3), np.longdouble))
    with pytest.raises(InvalidValueError, match=r"scales: expected a float32 array"):
        check_arrays(record, {"scales": ("G", 3)})
