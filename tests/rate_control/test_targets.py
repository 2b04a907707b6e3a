import pytest

from splatwire.errors import InvalidValueError
from splatwire.rate_control import Target, parse_size


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("500kB", 500_000),
        ("0.5MB", 500_000),
        ("0.5 mb", 500_000),
        ("500000", 500_000),
        ("12 B", 12),
        ("2KiB", 2048),
        ("1.5MiB", 3 << 19),
        (".25GB", 250_000_000),
    ],
)
def test_sizes_have_units_in_upper_or_lower_case(text, size):
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["", "kB", "-3kB", "0", "0.1", "5 parsecs", "1e5", "1,000", "nan", "inf"])
def test_texts_that_are_no_sizes_are_refused_by_name(text):
    with pytest.raises(InvalidValueError, match="a size is a number of bytes above 0"):
        parse_size(text)


@pytest.mark.parametrize("fields", [{}, {"size": 5, "psnr": 40.0}, {"size": 0}, {"psnr": 0.0}, {"psnr": float("nan")}])
def test_target_without_or_with_several_or_impossible_values_is_refused(fields):
    with pytest.raises(InvalidValueError):
        Target(**fields)
