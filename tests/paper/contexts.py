"""Scenes with gaps as torch tensors, and what concealers make of them."""

from typing import Any

from conceal import gaps
from splatwire.conceal import Concealer
from splatwire.model import Partial
from splatwire.model.tensors import to_tensors
from splatwire.scene import Anchors


def random_context(*args: Any, **options: Any) -> Partial:
    """Does as `conceal.gaps.random_context`, in tensors."""
    return to_tensors(gaps.random_context(*args, **options))


def estimate(concealer: Concealer, context: Partial) -> Anchors:
    """Anchors with their gaps filled by a concealer, in tensors."""
    return to_tensors(concealer(context).elements)
