from decimal import Decimal, getcontext

import numpy as np
from scipy.special import ndtr

from splatwire.codec.gaussians import fit, tables
from splatwire.codec.gaussians.layout import (
    BITS,
    MAX_COMPANDED,
    MEAN_FRACTION_BITS,
    NARROW_WEIGHT,
    SCALE_INDEX_STEP,
    WIDE_SCALE_OFFSET,
)
from splatwire.entropy.tables import INVERSE_BITS, NUM_SCALES, inverse_scale_table


def test_powers_and_logarithms_equal_the_reference() -> None:
    getcontext().prec = 50
    assert int(Decimal(2).ln() * 2**tables._LN2_BITS) == tables._LN2
    np.testing.assert_allclose(tables.exponentials(), 2.0 ** (np.arange(1 << BITS) / 4096), rtol=1e-15)


def test_flatness_inverts_companding() -> None:
    t = np.arange(MAX_COMPANDED + 1)
    ratio = -np.log2(1 - t / 4096 * np.log(2))
    assert np.abs(tables.flatness_table() - ratio * 4096).max() <= 1
    assert (np.diff(tables.flatness_table()) >= 0).all()


def test_expected_magnitudes_are_those_of_the_mixtures() -> None:
    sigmas = 2.0**INVERSE_BITS / inverse_scale_table()[np.arange(0, NUM_SCALES, SCALE_INDEX_STEP)]
    share, ratio = NARROW_WEIGHT / 65536, 2.0 ** (WIDE_SCALE_OFFSET / 16)
    expected = [share * _magnitude(s) + (1 - share) * _magnitude(s * ratio) for s in sigmas.tolist()]
    np.testing.assert_allclose(fit._EXPECTED_MAGNITUDES, expected, rtol=1e-12)


def _magnitude(scale: float) -> float:
    """Mean magnitude of a rounded normal variable with a centre uniform within half a step."""
    if scale >= 8:
        return 0.7978845608 * scale
    half = 1 << (int(MEAN_FRACTION_BITS) - 1)
    means = np.arange(-half, half, dtype=np.float64) / (2 * half)
    edges = np.arange(64, dtype=np.float64)[:, None] + 0.5 - means
    return 2 * float(ndtr(-edges / scale).sum(axis=0).mean())
