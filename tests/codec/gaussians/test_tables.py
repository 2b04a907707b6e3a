from decimal import Decimal, getcontext

import numpy as np

from splatwire.codec.schemas.gaussians import tables
from splatwire.codec.schemas.gaussians.layout import BITS, MAX_THIN


def test_powers_and_logarithms_are_right() -> None:
    getcontext().prec = 50
    assert int(Decimal(2).ln() * 2**tables._LN2_BITS) == tables._LN2
    logs = np.arange(-3 << BITS, 3 << BITS, 7)
    np.testing.assert_allclose(tables.power_of_two(logs), 2.0 ** (logs / 4096), rtol=1e-15)


def test_thinness_inverts_companding() -> None:
    t = np.arange(MAX_THIN + 1)
    ratio = -np.log2(1 - t / 4096 * np.log(2))
    assert np.abs(tables.thinness_table() - ratio * 4096).max() <= 1
    assert (np.diff(tables.thinness_table()) >= 0).all()
