"""Result of a decoder: a scene of Gaussians or anchors, some of which may be lost, and its side information."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int64

from splatwire.arguments import CheckedFields, array_of, check_fields, checked
from splatwire.errors import InvalidValueError, shown
from splatwire.ops.arrays import to_numpy
from splatwire.reprs import summary_repr
from splatwire.types.loss_mask import LossMask
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

S = TypeVar("S", bound=Scene)
Record = TypeVar("Record")


@runtime_checkable
class Prediction(Protocol):
    """Typing protocol (structural type) for predicted values of all elements (Gaussians or anchors), such as `Prior`.

    The values are predicted from the side information, without any packet.
    """

    @property
    def num_elements(self) -> int:
        """Number of elements, N."""

    def predicted_log_sizes(self) -> Float[np.ndarray, "N"]:
        """Returns the predicted logarithm of the size of each element."""

    def filled(self, elements: Any, loss_mask: LossMask) -> Any:
        """Returns all elements. Predicted attribute values replace missing ones."""


@dataclass(frozen=True, eq=False)
class PredictedPositions(CheckedFields):
    """Predicted positions of Gaussians or anchors, for streams whose packets also contain the positions.

    Attributes:
        positions: Predicted positions of all Gaussians or anchors, world units, relative to the scene's origin. Lost
            elements are placed there.
    """

    positions: Float[Any, "N 3"]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class TierSizes(CheckedFields):
    """Approximate size of every element (Gaussian or anchor), received or lost, for the concealment of losses.

    An importance tier is a group of elements of similar importance. The encoder sends one typical size for each tier.

    Attributes:
        sizes: For each element, the typical size of its importance tier, above 0, in an arbitrary unit.
    """

    sizes: Float[Any, "N"]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class Copies(CheckedFields):
    """Coarse redundant copies of Gaussians, drawn by a receiver if the originals are lost.

    Attributes:
        indices: For each copy, index of its original Gaussian in the decoded scene, without duplicates.
        splats: Attributes of the copies.
        growth: Three parameters, chosen by the encoder, for concealing lost Gaussians that have no copy. The larger
            the first two, the more the size and the opacity of received neighbours increase. The third is the weight of
            a correction by a neural network (concealer `scene_free`).
    """

    indices: Int64[np.ndarray, "C"]
    splats: Splats
    growth: tuple[float, float, float]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class ReceivedScene(Generic[S]):
    """A decoded scene, in which elements (Gaussians or anchors) may be lost, and its side information.

    Side information is the data that all packets need; it is received completely.

    Attributes:
        scene: The scene; lost elements have placeholder values.
        loss_mask: Mask of received attributes.
        sections: Sections of the side information for concealers: bytes by section name.
        records: Further side information on the elements, at most one object of each type, such as `Prior`,
            `PredictedPositions`, `TierSizes`, `Copies` or `AnchorLayout`.
    """

    scene: S
    loss_mask: LossMask
    sections: Mapping[str, bytes] = field(default_factory=dict)
    records: tuple[Any, ...] = ()

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        check_fields(self)
        if not hasattr(type(self.scene), "ELEMENTS"):
            raise InvalidValueError(
                f"ReceivedScene.scene: expected a scene (`decode_stream` returns one in a ReceivedScene), "
                f"not {shown(self.scene)}"
            )
        rows = {self.scene.num_elements, len(self.loss_mask.received), *_element_counts(self.records)}
        if len(rows) != 1:
            raise InvalidValueError(f"scene, loss mask and records have different numbers of elements: {sorted(rows)}")

    @checked
    def get(self, kind: type[Record]) -> Record | None:
        """Returns the side information of a given type, such as `TierSizes`, or None if absent."""
        return next((record for record in self.records if isinstance(record, kind)), None)

    def __getitem__(self, kind: type[Record]) -> Record:
        """Returns the side information of a type, such as `TierSizes`.

        Raises:
            InvalidValueError: If there is no side information of that type.
        """
        record = self.get(kind)
        if record is None:
            raise InvalidValueError(
                f"the side information of this stream of {self.scene.ELEMENTS} has no {kind.__name__}"
            )
        return record

    @property
    def provides(self) -> frozenset[type]:
        """Types of the available side information, and the type of the elements, e.g. `Splats`."""
        return frozenset(map(type, (self.scene.elements, *self.records)))

    def with_records(self, *records: Any) -> "ReceivedScene[S]":
        """Returns a copy with further side information; a new record replaces an existing record of the same type."""
        kinds = tuple(map(type, records))
        return replace(self, records=(*(old for old in self.records if not isinstance(old, kinds)), *records))

    @property
    def elements(self) -> Any:
        """Elements of the scene: Gaussians, anchors or keyframe Gaussians."""
        return self.scene.elements

    @property
    def fully_received(self) -> Bool[np.ndarray, "N"]:
        """Mask of the elements with every attribute received."""
        return self.loss_mask.fully_received

    @property
    def known(self) -> Bool[np.ndarray, "N"]:
        """Deprecated name of `fully_received`."""
        warnings.warn("ReceivedScene.known is deprecated, use fully_received", DeprecationWarning, stacklevel=2)
        return self.loss_mask.fully_received

    @property
    def positions(self) -> Float[Any, "N 3"]:
        """Positions of all elements, received or lost, for neighbour searches.

        If the stream has predicted positions (`PredictedPositions`), these are the predicted positions of all elements,
        even of received ones. Otherwise, these are the decoded positions. Lost elements then have placeholder positions
        if the stream can lose positions.
        """
        predicted = self.get(PredictedPositions)
        return self.scene.positions if predicted is None else predicted.positions

    @property
    def prediction(self) -> Prediction | None:
        """Values that the side information predicts for every element, e.g. a `Prior`; None if there are none."""
        return next((record for record in self.records if isinstance(record, Prediction)), None)

    @property
    def expectation(self) -> Prediction | None:
        """Deprecated name of `prediction`."""
        warnings.warn("ReceivedScene.expectation is deprecated, use prediction", DeprecationWarning, stacklevel=2)
        return self.prediction

    @property
    def log_sizes(self) -> Float[np.ndarray, "N"]:
        """Expected natural logarithm of the size of each element, received or lost."""
        prediction = self.prediction
        return to_numpy(self.elements.log_sizes if prediction is None else prediction.predicted_log_sizes())

    @property
    def tier_sizes(self) -> Float[np.ndarray, "N"] | None:
        """For each element, the typical size of its importance tier; None if the stream has no sizes."""
        tiers = self.get(TierSizes)
        return None if tiers is None else tiers.sizes

    @property
    def sizes(self) -> Float[np.ndarray, "N"]:
        """Approximate size of each element, received or lost, in an arbitrary unit, float64 (N)."""
        tiers = self.tier_sizes
        return np.exp(self.log_sizes.astype(np.float64)) if tiers is None else to_numpy(tiers).astype(np.float64)

    @property
    def filled(self) -> Any:
        """Elements of the scene, with missing values replaced by the values that the side information predicts."""
        prediction = self.prediction
        return self.elements if prediction is None else prediction.filled(self.elements, self.loss_mask)

    def masked(self, fully_received: Bool[np.ndarray, "N"]) -> "ReceivedScene[S]":
        """Simulates losses: returns a copy in which only the elements of the mask `fully_received` count as received.

        Raises:
            InvalidValueError: If `fully_received` is not a boolean for each element.
        """
        fully_received = array_of(fully_received, "fully_received", (self.scene.num_elements,), "b")
        elements = self.scene.elements.with_losses(fully_received, self.positions)
        return replace(
            self,
            scene=self.scene.with_elements(elements, self.scene.hints),
            loss_mask=LossMask.of_elements(fully_received),
        )


def _element_counts(records: tuple[Any, ...]) -> set[int]:
    """Returns the distinct numbers of elements in the records of side information.

    Consistent records give a single number.
    """
    rows = set()
    for record in records:
        if isinstance(record, Prediction):
            rows.add(record.num_elements)
        elif isinstance(record, PredictedPositions):
            rows.add(len(record.positions))
        elif isinstance(record, TierSizes):
            rows.add(len(record.sizes))
    return rows
