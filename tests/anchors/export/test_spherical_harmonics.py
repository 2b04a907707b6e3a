import math

import numpy as np
import pytest
from scipy.special import sph_harm_y

from close import unit
from splatwire.errors import InvalidValueError
from splatwire.ops.spherical_harmonics import DC, degree_of, num_functions, sh_basis


def _directions(count: int) -> np.ndarray:
    vectors = np.random.default_rng(0).standard_normal((count, 3))
    return unit(vectors)


@pytest.mark.parametrize("degree", range(4))
def test_basis_equals_scipy_harmonics(degree: int) -> None:
    directions = _directions(200)
    x, y, z = directions.T
    polar, azimuth = np.arccos(z), np.arctan2(y, x)
    expected = []
    for order in range(degree + 1):
        for m in range(-order, order + 1):
            value = sph_harm_y(order, abs(m), polar, azimuth)
            part = value.imag if m < 0 else value.real
            expected.append(part * (math.sqrt(2) if m else 1))
    np.testing.assert_allclose(sh_basis(directions, degree), np.stack(expected, axis=1), atol=1e-12)


def test_constants_equal_those_of_3dgs() -> None:
    up, right = np.array([0.0, 0.0, 1.0], np.float32), np.array([1.0, 0.0, 0.0], np.float32)
    assert pytest.approx(0.28209479177387814) == DC
    assert float(sh_basis(up, 3)[2]) == pytest.approx(0.4886025119029199)
    assert float(sh_basis(right, 3)[3]) == pytest.approx(-0.4886025119029199)
    assert float(sh_basis(up, 3)[6]) == pytest.approx(2 * 0.31539156525252005)
    assert float(sh_basis(right, 3)[15]) == pytest.approx(-0.5900435899266435)


def test_degrees_and_coefficient_counts_match() -> None:
    assert [num_functions(degree) for degree in range(4)] == [1, 4, 9, 16]
    assert [degree_of(count) for count in (1, 4, 9, 16)] == [0, 1, 2, 3]
    for call in (lambda: num_functions(4), lambda: num_functions(-1), lambda: degree_of(5), lambda: degree_of(25)):
        with pytest.raises(InvalidValueError, match="degree"):
            call()
