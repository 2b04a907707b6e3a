import itertools

import numpy as np

from splatwire.ops.sort3 import sort3


def test_three_numbers_are_sorted():
    values = np.array([*itertools.product([0.0, 1.0, 2.0, np.inf], repeat=3)], dtype=np.float32)
    np.testing.assert_array_equal(np.stack(sort3(values), axis=1), np.sort(values, axis=1))
