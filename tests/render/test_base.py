import pytest

from splatwire.errors import UnknownNameError
from splatwire.render import create_renderer, renderer_names


def test_unknown_renderer_names_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"'gpu'.*cpu, gsplat, reference"):
        create_renderer("gpu")


def test_names_are_those_that_can_be_created() -> None:
    assert renderer_names() == ("cpu", "reference", "gsplat")
    assert all(callable(create_renderer(name)) for name in ("cpu", "reference"))
