import pytest

from splatwire.errors import InvalidValueError
from splatwire.evaluate import Method, Protocol, concealment_methods


def test_rows_have_the_usual_order():
    names = [m.name for m in concealment_methods(("mine", "grow", "idw", "drop"), contiguous=True)]
    assert names == ["no loss", "contiguous drop", "drop", "idw", "grow", "mine"]
    assert [m.name for m in concealment_methods(("drop",), complete=False)] == ["drop"]


@pytest.mark.parametrize("seeds", [(), (1, 1), (-1,), tuple(range(1001))])
def test_bad_seeds(seeds):
    with pytest.raises(InvalidValueError, match="seeds"):
        Protocol((Method("drop"),), seeds=seeds)


@pytest.mark.parametrize("methods", [(), (Method("drop"), Method("drop", concealer="idw"))])
def test_bad_methods(methods):
    with pytest.raises(InvalidValueError, match="methods"):
        Protocol(methods)
