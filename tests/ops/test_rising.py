import itertools

import numpy as np

from splatwire.ops.rising import rising


def test_three_numbers_come_out_in_order_whatever_order_they_had():
    values = np.array([*itertools.product([0.0, 1.0, 2.0, np.inf], repeat=3)], dtype=np.float32)
    np.testing.assert_array_equal(np.stack(rising(values), axis=1), np.sort(values, axis=1))
