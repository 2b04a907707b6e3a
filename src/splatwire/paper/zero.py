"""Concealer `zero`: a receiver without loss detection, which decodes missing values as zero."""

from dataclasses import dataclass

from splatwire.concealment.base import Concealed
from splatwire.concealment.registry import register_concealer
from splatwire.types import Anchors, ReceivedScene


@register_concealer("zero", needs=[Anchors], listed=False)
@dataclass(frozen=True)
class Zero:
    """Concealer that sets missing values to zero, as a baseline for comparisons."""

    # Received values remain, also those of a feature of which only some channels arrived. An anchor without its
    # offset mask is not drawn. If each packet contains all attributes of its anchors, the result equals that of the
    # concealer `drop`. For this reason `concealer_names` does not list `zero`, but it can be created by its name.

    @property
    def name(self) -> str:
        """Name in the registry of concealers: `zero`."""
        return "zero"

    def __call__(self, context: ReceivedScene) -> Concealed:
        """Returns the scene with zeros for missing values."""
        return Concealed.filled(context.elements)
