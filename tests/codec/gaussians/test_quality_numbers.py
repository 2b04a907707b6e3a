import numpy as np
import pytest

from splatwire.codec.gaussians.quality import QUALITIES, QUALITY_NUMBERS, Quality, quality_of
from splatwire.errors import InvalidValueError


@pytest.mark.parametrize("name", QUALITIES)
def test_quality_names_equal_their_quality_numbers(name):
    assert quality_of(QUALITY_NUMBERS[name]) == quality_of(name)
    assert quality_of(int(QUALITY_NUMBERS[name])) == quality_of(name)


@pytest.mark.parametrize("degree", [0, 3])
def test_steps_of_every_class_become_finer_with_the_number(degree):
    coarsest = np.array([quality_of(number).base_exponents(degree) for number in np.linspace(0, 100, 401)])
    classes = [quality_of(number).num_classes(degree) for number in np.linspace(0, 100, 401)]
    finest = coarsest + 64 * (np.array(classes) - 1)[:, None]
    assert (np.diff(coarsest, axis=0) >= 0).all()
    below = np.array(classes[:-1]) == np.array(classes[1:])
    assert (np.diff(finest, axis=0)[below] >= 0).all()


@pytest.mark.parametrize("number", [-0.1, 100.5, float("nan"), float("inf"), True])
def test_numbers_out_of_range_are_refused(number):
    with pytest.raises(InvalidValueError, match="quality"):
        quality_of(number)


def test_quality_number_as_a_level_is_explained():
    with pytest.raises(InvalidValueError, match=r"level is -8 to 24 .*, not 60 and 0; .* such as quality=60"):
        Quality(60.0)
