import pytest

from splatwire.errors import UnknownNameError
from splatwire.render import create_renderer, renderer_names


def test_unknown_renderer_error_lists_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"'gpu'.*cpu, gsplat, reference"):
        create_renderer("gpu")


@pytest.mark.needs_torch
def test_listed_renderers_can_be_created() -> None:
    assert renderer_names() == ("cpu", "gsplat", "reference")
    assert all(callable(create_renderer(name)) for name in ("cpu", "reference"))
