"""Laws of the checks of arguments by annotations, `splatwire.arguments`."""

import dataclasses
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import pytest
from jaxtyping import Bool, Float

from splatwire.arguments import MAX_THREADS, array_of, check_fields, check_threads, checked, checked_except
from splatwire.errors import InvalidValueError


class Named(Protocol):
    @property
    def name(self) -> str: ...


class Slow:
    """Has a property that must not be read."""

    @property
    def name(self) -> str:
        raise AssertionError("the property was evaluated")


@checked
def call(
    number: int = 0, factor: float = 0.0, on: bool = False, text: str = "", data: bytes = b"", path: Path = Path("a"),
    source: str | os.PathLike[str] = "a", kind: Literal["a", "b"] = "a", names: tuple[str, ...] = (),
    pair: tuple[int, float] = (0, 0.0), numbers: Sequence[float] = (), items: Iterable[int] = (),
    table: Mapping[str, int] | None = None, hook: Callable[..., Any] | None = None, named: Named | None = None,
    values: Float[np.ndarray, "N"] | None = None, missing: "Unknown | None" = None,  # type: ignore[name-defined]
) -> Any:  # fmt: skip
    """Returns its arguments."""
    return dict(locals())


@dataclasses.dataclass(frozen=True)
class Record:
    values: Float[Any, "N 3"]
    mask: Bool[Any, "N"]
    count: int = 0
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)


GOOD = {
    "number": (3, np.int64(3)), "factor": (1, 1.5, np.float32(2), float("inf")), "on": (True, np.True_),
    "text": ("a",), "data": (b"a",), "path": ("a", Path("a")), "source": ("a", Path("a")), "kind": ("b",),
    "names": (("a", "b"), ["a"]), "pair": ((1, 2.0), [1, 2]), "numbers": ([1, 2.0], np.ones(3), range(3)),
    "items": ([1], {1, 2}), "table": ({"a": 1}, None), "hook": (len, None), "named": (Slow(), None),
    "values": (np.ones(3), [1.0], None), "missing": (object(),),
}  # fmt: skip
BAD = {
    "number": (True, 1.5, "1", None, [1], np.ones(1), 1 << 200), "factor": (float("nan"), "1", None, 1j, True),
    "on": (1, "true", None), "text": (1, None, b"a"), "data": ("a", 3), "path": ("", "a\0b", 3, b"a", None),
    "source": (None, 3, ""), "kind": ("c", 1, [1]), "names": ("ab", [1], ("a", 1), 5, (name for name in "ab")),
    "pair": ((1,), (1, "a"), None), "numbers": ("12", {1: 2}, [None], 3), "items": (None, "ab", ["a"]),
    "table": ([1], {1: 2}, {"a": "b"}), "hook": (3, "len"), "named": (3, Slow), "values": ("a", 3, {}),
}  # fmt: skip


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in GOOD.items() for value in values])
def test_arguments_of_the_annotated_type_pass(name, value):
    assert name in call(**{name: value})


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in BAD.items() for value in values])
def test_other_arguments_are_an_error_that_names_the_parameter(name, value):
    with pytest.raises(InvalidValueError, match=f"^{name}: expected .*, not "):
        call(**{name: value})


def test_messages_about_lists_name_the_types_of_their_items():
    with pytest.raises(InvalidValueError, match=r"^items: expected a sequence of .*, not list of int, str$"):
        call(items=[1, "two", 3])  # type: ignore[list-item]
    with pytest.raises(InvalidValueError, match=r"^pair: expected .*, not tuple of str$"):
        call(pair=("a",))
    with pytest.raises(InvalidValueError, match=r"^table: expected a dictionary of .*, not dict of str by int$"):
        call(table={1: "a"})


def test_positional_arguments_are_checked():
    with pytest.raises(InvalidValueError, match=r"^factor: expected a number, not 'x'"):
        call(1, "x")


def test_arguments_are_converted_to_the_annotated_type():
    found = call(np.int64(3), path="a/b", names=["a"])
    assert (type(found["number"]), found["path"], found["names"]) == (int, Path("a/b"), ("a",))


def test_items_of_an_iterator_are_checked_as_they_are_read():
    def numbers():
        yield 1
        yield "two"

    items = iter(call(items=numbers())["items"])
    assert next(items) == 1
    with pytest.raises(InvalidValueError, match="expected a whole number in each item, not 'two'"):
        next(items)


def test_parameters_left_to_the_function_are_not_checked():
    @checked_except("number")
    def own(number: int, text: str = "") -> Any:
        return number

    assert own("three") == "three"
    with pytest.raises(InvalidValueError, match=r"^text: "):
        own(3, 4)


def test_fields_are_checked_and_arrays_of_a_record_fit_each_other():
    values, mask = np.ones((4, 3), np.float32), np.ones(4, np.bool_)
    assert Record(values, mask, np.int64(2), ["a"]).names == ("a",)
    for wrong, message in (
        ((values[0], mask), "Record.values: expected a float32 array (N, 3), not float32 (3,)"),
        ((values, mask[:2]), "Record.mask: expected a bool array (N,), not bool (2,) (N = 4)"),
        ((values[:, :2], mask), "Record.values: expected a float32 array (N, 3), not float32 (4, 2)"),
        ((values.astype(int), mask), "Record.values: expected a float32 array (N, 3), not int64 (4, 3)"),
        ((values, mask, "2"), "Record.count: expected a whole number, not '2'"),
    ):
        with pytest.raises(InvalidValueError, match=f"^{re.escape(message)}$"):
            Record(*wrong)


@pytest.mark.parametrize(
    ("value", "kind", "limits"),
    [([1, 2], "f", (None, None)), ([True, False], "b", (None, None)), (np.arange(2), "i", (0, 1))],
)
def test_arrays_and_lists_of_numbers_become_arrays(value, kind, limits):
    assert array_of(value, "values", ("N",), kind, *limits).tolist() == list(value)


@pytest.mark.parametrize(
    ("value", "kind"),
    [([[1], [1, 2]], "f"), ("ab", "f"), (None, "f"), ([None], "f"), ([1.5], "i"), ([1], "b"), (3, "f"), ([-1], "i"),
     ([2], "i"), ([float("nan")], "f"), ([10**30], "i"), ([[1]], "f")],
)  # fmt: skip
def test_other_values_are_no_array_of_that_kind_shape_and_range(value, kind):
    with pytest.raises(InvalidValueError, match=r"^values: expected an array \(N,\) of "):
        array_of(value, "values", ("N",), kind, 0, 1)


def test_threads_are_limited():
    check_threads(None)
    check_threads(MAX_THREADS)
    with pytest.raises(InvalidValueError, match="threads must be a whole number of at most"):
        check_threads(10**30)
