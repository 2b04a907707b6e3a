"""Tests run with run-time type checks of arrays and all other arguments."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest
from beartype import beartype
from jaxtyping import Float, TypeCheckError

from splatwire.anchors.voxels import voxel_indices
from splatwire.errors import check_kind
from splatwire.files.byte_io import ByteReader
from type_checks import CHECK_INTERVAL, checking

if TYPE_CHECKING:
    from collections.abc import Sized  # unknown types at run time may be anything

checked = checking(typechecker=beartype)


def test_package_functions_methods_and_dataclasses_are_type_checked():
    with pytest.raises(TypeCheckError):
        check_kind(1, int, 3)
    with pytest.raises(TypeCheckError):
        ByteReader(b"abc", "x").take("two")
    # annotations with shapes are checked, too (after many calls one of `CHECK_INTERVAL`)
    wrong = []
    for _ in range(CHECK_INTERVAL):
        try:
            voxel_indices(np.zeros((3, 4), np.float32), 0.5)
        except TypeCheckError as error:
            wrong.append(error)
    assert wrong


def test_wrong_types_of_arguments_results_and_fields_raise():
    @checked
    def number(
        value: "int", other: "Sized", more: "tuple[Sized, ...]" = (), all: tuple["Sized", int] = ((), 1)
    ) -> "str":
        return value if other else "one"

    @checked
    def both(a: Float[np.ndarray, "N"], b: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
        return a + b

    @checked
    @dataclasses.dataclass
    class Pair:
        first: int
        second: tuple[str, ...] = ()

    assert number(1, other=0) == "one"
    with pytest.raises(TypeCheckError):
        number("1", other=0)
    with pytest.raises(TypeCheckError):
        number(1, other=object())
    assert both(np.zeros(3), np.ones(3)).sum() == 3
    with pytest.raises(TypeCheckError):
        both(np.zeros(3), np.ones(1))
    assert Pair(1, ("a",)).first == 1
    for wrong in (("1",), (1, (2,))):
        with pytest.raises(TypeCheckError):
            Pair(*wrong)


def test_functions_without_annotations_are_unchanged():
    def plain(a, b=1):
        return a + b

    assert checked(plain) is plain
