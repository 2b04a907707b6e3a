"""What a decoder returns: a scene of which some elements may be lost, and all that the stream says of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int64

from splatwire.errors import InvalidValueError
from splatwire.model.scene import Scene
from splatwire.ops.arrays import to_numpy
from splatwire.reprs import summary_repr
from splatwire.scene import Erasures
from splatwire.scene.splats import Splats

S = TypeVar("S", bound=Scene)
Said = TypeVar("Said")


@runtime_checkable
class Expectation(Protocol):
    """What the side information predicts of every element, lost or received: `Prior`, or another schema's own."""

    @property
    def num_elements(self) -> int:
        """Elements, N."""

    def expected_log_sizes(self) -> Float[np.ndarray, "N"]:
        """Logarithm of the size that is expected of each element."""

    def filled(self, elements: Any, erasures: Erasures) -> Any:
        """The elements with every gap filled by what is expected."""


@dataclass(frozen=True, eq=False)
class ExpectedPlaces:
    """Where elements are expected to be before their packets come, of a stream whose packets say where they are.

    Attributes:
        positions: World coordinates; lost elements stand there.
    """

    positions: Float[Any, "N 3"]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class TierSizes:
    """How large the elements of each one's tier are.

    Attributes:
        sizes: Relative to other tiers, above 0, of received and lost elements alike.
    """

    sizes: Float[Any, "N"]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class Copies:
    """Copies of some Gaussians that came apart from packets, and how best to draw a scene that has them.

    Attributes:
        places: Which Gaussians these are, all different.
        splats: The copies.
        growth: Where packets are lost, what the sender found best for it: exponents of size and opacity over the share
            that is lost, and how much of the scene-free network's change of them is taken.
    """

    places: Int64[np.ndarray, "C"]
    splats: Splats
    growth: tuple[float, float, float]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class Partial(Generic[S]):
    """A scene of which some elements may be lost, and all that the side information says of it.

    Attributes:
        scene: The scene. A lost element is as the schema's decoder leaves it, and is never drawn as it is.
        erasures: What was received.
        sections: Named sections that a sender left for concealers, content by name.
        said: What else is known of every element, one record of a kind: an `Expectation`, `ExpectedPlaces`,
            `TierSizes`, `Copies`, `AnchorLayout`, or a kind of a schema's own. What a schema has nothing for is not
            there.
    """

    scene: S
    erasures: Erasures
    sections: Mapping[str, bytes] = field(default_factory=dict)
    said: tuple[Any, ...] = ()

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        rows = {self.scene.num_elements, len(self.erasures.received), *_rows(self.said)}
        if len(rows) != 1:
            raise ValueError(f"scene, erasures and what is said of them do not fit: {sorted(rows)} rows")

    def find(self, kind: type[Said]) -> Said | None:
        """What is said of a kind; None if nothing is."""
        return next((record for record in self.said if isinstance(record, kind)), None)

    def __getitem__(self, kind: type[Said]) -> Said:
        """What is said of a kind.

        Raises:
            InvalidValueError: If nothing is.
        """
        found = self.find(kind)
        if found is None:
            raise InvalidValueError(f"this stream of {self.scene.ELEMENTS} says nothing of kind {kind.__name__}")
        return found

    @property
    def offers(self) -> frozenset[type]:
        """Kinds of records that a concealer finds here, that of the elements among them."""
        return frozenset(map(type, (self.scene.elements, *self.said)))

    def saying(self, *records: Any) -> "Partial[S]":
        """The same with records added, in place of others of their kind."""
        kinds = tuple(map(type, records))
        return replace(self, said=(*(old for old in self.said if not isinstance(old, kinds)), *records))

    @property
    def elements(self) -> Any:
        """The scene's elements."""
        return self.scene.elements

    @property
    def known(self) -> Bool[np.ndarray, "N"]:
        """Elements of which everything was received."""
        return self.erasures.known

    @property
    def places(self) -> Float[Any, "N 3"]:
        """Where elements are for the search of neighbours: lost and received ones are measured alike."""
        expected = self.find(ExpectedPlaces)
        return self.scene.positions if expected is None else expected.positions

    @property
    def expectation(self) -> Expectation | None:
        """What is expected of every element; None where a decoder leaves lost elements as they are expected."""
        return next((record for record in self.said if isinstance(record, Expectation)), None)

    @property
    def log_sizes(self) -> Float[np.ndarray, "N"]:
        """Logarithm of the size that is expected of each element."""
        expected = self.expectation
        return to_numpy(self.elements.log_sizes if expected is None else expected.expected_log_sizes())

    @property
    def tier_sizes(self) -> Float[np.ndarray, "N"] | None:
        """Size of each one's tier; None where the side information does not say."""
        tiers = self.find(TierSizes)
        return None if tiers is None else tiers.sizes

    @property
    def sizes(self) -> Float[np.ndarray, "N"]:
        """What an element counts for among its neighbours, float64: the size of its tier, or else its own."""
        tiers = self.tier_sizes
        return np.exp(self.log_sizes.astype(np.float64)) if tiers is None else to_numpy(tiers).astype(np.float64)

    @property
    def filled(self) -> Any:
        """The elements with every gap filled by what is expected."""
        expected = self.expectation
        return self.elements if expected is None else expected.filled(self.elements, self.erasures)

    def without(self, known: Bool[np.ndarray, "N"]) -> "Partial[S]":
        """The same when only some elements are there, as if the packets of the others had not come."""
        there = self.scene.elements.arrived(known, self.places)
        return replace(
            self, scene=self.scene.with_elements(there, self.scene.hints), erasures=Erasures.of_anchors(known)
        )


def _rows(said: tuple[Any, ...]) -> set[int]:
    """Rows of the records that say something of each element."""
    rows = set()
    for record in said:
        if isinstance(record, Expectation):
            rows.add(record.num_elements)
        elif isinstance(record, ExpectedPlaces):
            rows.add(len(record.positions))
        elif isinstance(record, TierSizes):
            rows.add(len(record.sizes))
    return rows
