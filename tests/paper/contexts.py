"""Scenes with lost anchors as torch tensors, and their concealed anchors."""

from typing import Any

from concealment import gaps
from splatwire.concealment import Concealer
from splatwire.neural.model.tensors import to_tensors
from splatwire.types import Anchors, ReceivedScene


def random_context(*args: Any, **options: Any) -> ReceivedScene:
    """Equals `concealment.gaps.random_context`, in tensors."""
    return to_tensors(gaps.random_context(*args, **options))


def estimate(concealer: Concealer, context: ReceivedScene) -> Anchors:
    """Scene in tensors, with lost anchors estimated by a concealer."""
    return to_tensors(concealer(context).elements)
