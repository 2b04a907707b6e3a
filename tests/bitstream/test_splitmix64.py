import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference.splitmix64 import splitmix64_reference
from splatwire.bitstream.splitmix64 import GAMMA, MASK64, splitmix64
from splatwire.errors import InvalidValueError

PUBLISHED_1234567 = [
    6457827717110365317,
    3203168211198807973,
    9817491932198370423,
    4593380528125082431,
    16408922859458223821,
]


def test_splitmix64_equals_the_published_vectors():
    states = [(1234567 + i * GAMMA) & MASK64 for i in range(5)]  # state of the generator before each output
    assert splitmix64(np.array(states, np.uint64)).tolist() == PUBLISHED_1234567
    assert [splitmix64_reference(state) for state in states] == PUBLISHED_1234567
    assert splitmix64(np.zeros(1, np.uint64)).tolist() == [0xE220A8397B1DCDAF]


@settings(deadline=None)
@given(st.lists(st.integers(0, MASK64), min_size=1, max_size=20))
def test_splitmix64_equals_plain_integer_arithmetic(numbers):
    assert splitmix64(np.array(numbers, np.uint64)).tolist() == [splitmix64_reference(n) for n in numbers]


def test_splitmix64_keeps_input_and_shape():
    x = np.arange(6, dtype=np.uint64).reshape(2, 3)
    assert splitmix64(x).shape == (2, 3)
    assert x.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert int(splitmix64(np.array(0, np.uint64))) == 0xE220A8397B1DCDAF


def test_splitmix64_refuses_signed_numbers():
    with pytest.raises(InvalidValueError, match="int64"):
        splitmix64(np.arange(3))
