import hashlib

import numpy as np
from scipy.special import expit, ndtr

from splatwire.entropy import tables


def digest(table: np.ndarray) -> str:
    return hashlib.sha256(table.astype("<i8").tobytes()).hexdigest()[:16]


def test_tables_are_pinned() -> None:
    # one different entry makes every stream undecodable, so tables never change within a format version
    assert digest(tables.normal_table()) == "be354dbf4d6701d7"
    assert digest(tables.inverse_scale_table()) == "4ffd79d2cee04b00"
    assert digest(tables.half_width_table()) == "819a0da4fd31092e"
    assert digest(tables.logistic_table()) == "0154e2ecec5d8969"
    assert digest(tables.step_table(1024, 4, 16)) == "fd9fd815695828e9"


def test_normal_table_equals_the_normal_distribution() -> None:
    table = tables.normal_table()
    z = np.arange(len(table)) / 128 - 6
    assert np.abs(table - ndtr(z) * 2**24).max() <= 0.51
    assert (np.diff(table) >= 0).all()
    assert (table + table[::-1] == 2**24).all()


def test_inverse_scales_are_bin_centres() -> None:
    inverse = tables.inverse_scale_table() / 2**tables.INVERSE_BITS
    index = np.arange(tables.NUM_SCALES)
    scale = 2.0 ** (index // 16 - 6) * (1 + (index % 16 + 0.5) / 16)
    assert np.allclose(inverse * scale, 1, atol=2e-2)
    assert np.allclose((inverse * scale)[: 16 * 12], 1, atol=1e-4)


def test_logistic_tables_equal_the_logistic_function() -> None:
    logits = (np.arange(tables.NUM_LOGITS) - 128) / 16
    assert np.abs(tables.logistic_table() - 65536 * expit(logits)).max() <= 0.51
    q = np.arange(-4096, 4097) / 1024
    assert np.abs(tables.step_table(1024, 4, 16) - 65536 * (1 + np.tanh(q))).max() <= 1.01
