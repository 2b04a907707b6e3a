"""The sketch: anchors that matter most are drawn from a coarse copy in the side information, others are grown over."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from splatwire.conceal.base import Concealed
from splatwire.conceal.grow import Grow
from splatwire.conceal.registry import register_concealer
from splatwire.conceal.scene_free.elements import ElementInputs, element_inputs, grown
from splatwire.conceal.scene_free.network import GainInputs, gain_inputs
from splatwire.conceal.scene_free.signature import near_losses
from splatwire.conceal.scene_free.surroundings import surroundings_of
from splatwire.conceal.scene_free.weights import default_element_weights, default_weights
from splatwire.conceal.sketch.section import (
    SCALING_COLUMNS,
    SECTION,
    SketchSection,
    SketchSizes,
    read_sketch,
    size_buckets,
)
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, Copies, Partial, Prior, SplatScene
from splatwire.ops.arrays import lower_median, to_arrays, to_numpy
from splatwire.scene import AnchorLayout, Attribute, Erasures
from splatwire.scene.splats import Splats

MAX_LOG_SIZE = 6.0
"""Scalings are kept within a factor of `exp(6)` of the expected ones, whatever a section says."""
_LEAST_SHARE = 0.05


@register_concealer("sketch", section=SECTION)
@dataclass(frozen=True)
class Sketch:
    """Reads coarse copies of important anchors from the stream, leaves other lost anchors out, and grows what is there.

    `splatwire calibrate sketch` puts the section into a stream. What was received is never replaced by its
    copy. The growth is that of `Grow`, corrected by the network of `SceneFree` as far as the section trusts it, around
    holes that really are holes: a sketched anchor counts as present. Explicit Gaussians have copies that the codec
    reads (`Copies`), and the growth of their own network with exponents that the section says.
    """

    @property
    def name(self) -> str:
        """`sketch`."""
        return "sketch"

    def __call__(self, partial: Partial) -> Concealed:
        """See `Concealer`.

        Raises:
            InvalidValueError: If the stream has no such section.
            BitstreamError: If the section is damaged or of another scene.
        """
        copies = partial.find(Copies)
        if copies is not None:
            return conceal_with_copies(partial, copies)
        if SECTION not in partial.sections:
            raise _missing()
        section = read_sketch(partial.sections[SECTION], sizes_of(partial), buckets_of(partial))
        return conceal_with(partial, section)


def _missing() -> InvalidValueError:
    return InvalidValueError(
        f"concealer 'sketch' needs the section '{SECTION}', which this stream does not have: add it with "
        "`splatwire calibrate sketch`, or use 'grow'"
    )


def conceal_with(partial: Partial[AnchorScene], section: SketchSection) -> Concealed:
    """Conceals anchors with a sketch that was read already."""
    filled = with_sketch(partial, section)
    if section.trust and bool(filled.known.any()):
        return SketchedLoss.of(filled).proposal(section)
    grow = Grow(exponent=section.exponent, max_excess=section.max_excess)
    return replace(grow(filled), elements=filled.filled)


def conceal_with_copies(partial: Partial[SplatScene], copies: Copies) -> Concealed:
    """Conceals explicit Gaussians with copies, and grows what is there as their sender found best."""
    filled = with_copies(partial, copies)
    return grown_with_copies(filled, element_inputs(filled), copies.growth)


def grown_with_copies(
    filled: Partial[SplatScene], inputs: ElementInputs, growth: tuple[float, float, float]
) -> Concealed:
    """What to draw of explicit Gaussians with their copies in place, with a growth.

    Args:
        filled: What `with_copies` returned.
        inputs: Its surroundings.
        growth: See `Copies`.
    """
    size, opacity, trust = growth
    gains = default_element_weights()(inputs, trust, (size, opacity))
    return replace(grown(filled, inputs.rows, gains), elements=filled.elements)


def with_copies(partial: Partial[SplatScene], copies: Copies) -> Partial[SplatScene]:
    """The same scene when lost Gaussians of which there are copies count as received; all others stay."""
    lost = ~partial.known[copies.places]
    places, chosen = copies.places[lost], copies.splats.select(lost)
    splats = {name: values.copy() for name, values in vars(partial.scene.splats).items()}
    for name, values in splats.items():
        values[places] = getattr(chosen, name)
    received = partial.erasures.received.copy()
    received[places] = True
    return replace(partial, scene=partial.scene.with_elements(Splats(**splats)), erasures=Erasures(received))


@dataclass(frozen=True, eq=False)
class SketchedLoss:
    """A lossy scene with the copies in place, and all of its surroundings that the growth follows from.

    Attributes:
        filled: What `with_sketch` returned, with at least one anchor to draw.
        left: Share of the neighbours that is there, of each anchor that is drawn.
        inputs: What the network sees of them.
    """

    filled: Partial[AnchorScene]
    left: Float[np.ndarray, "M"]
    inputs: GainInputs

    @staticmethod
    def of(filled: Partial[AnchorScene]) -> "SketchedLoss":
        """Looks at the surroundings, which takes the time."""
        around = surroundings_of(filled, np.flatnonzero(filled.known))
        return SketchedLoss(filled, 1 - near_losses(filled, around), gain_inputs(filled, around))

    def proposal(self, section: SketchSection) -> Concealed:
        """What to draw with the growth of a section; its copies are not looked at again."""
        rule = Grow(exponent=section.exponent, max_excess=section.max_excess)
        gain = rule.gain(self.left, self.filled.known, self.filled.tier_sizes)
        gains = default_weights()(replace(self.inputs, grown=gain), section.trust)
        return replace(grown(self.filled, self.inputs.rows, gains), elements=self.filled.filled)


def with_sketch(partial: Partial[AnchorScene], section: SketchSection) -> Partial[AnchorScene]:
    """The same scene when sketched anchors are known as well; what was received stays."""
    anchors, received = to_arrays(partial.scene.anchors), partial.erasures.received
    drawn = section.levels > 0
    rows = np.flatnonzero(drawn)
    features, scalings, offsets, mask = sketched_attributes(section, expected_scalings(partial[Prior])[rows])

    def fill(attribute: Attribute, decoded: np.ndarray, sketched: np.ndarray) -> np.ndarray:
        column = received[rows, int(attribute)].reshape(-1, *[1] * (decoded.ndim - 1))
        filled = decoded.copy()
        filled[rows] = np.where(column, decoded[rows], sketched)
        return filled

    filled = replace(
        anchors,
        features=fill(Attribute.FEATURE, anchors.features, features),
        scalings=fill(Attribute.SCALING, anchors.scalings, scalings),
        offsets=fill(Attribute.OFFSET, anchors.offsets, offsets),
        mask=fill(Attribute.MASK, anchors.mask, mask),
    )
    erasures = Erasures(received | drawn[:, None])
    return replace(partial, scene=partial.scene.with_elements(filled), erasures=erasures)


def expected_scalings(prior: Prior) -> Float[np.ndarray, "N 6"]:
    """The prior's mean, where that is very small (or not positive) a share of its median."""
    mean = to_numpy(prior.scaling.mean)
    floor = np.float32(_LEAST_SHARE) * lower_median(mean) if len(mean) else np.zeros(6, np.float32)
    return np.maximum(np.maximum(mean, floor), np.float32(1e-9))


def sketched_attributes(
    section: SketchSection, expected: Float[np.ndarray, "M 6"]
) -> tuple[Float[np.ndarray, "M F"], Float[np.ndarray, "M 6"], Float[np.ndarray, "M K 3"], Bool[np.ndarray, "M K"]]:
    """Features, scalings, offsets and masks of the sketched anchors, always finite.

    Args:
        section: The sketch.
        expected: `expected_scalings` of these anchors.
    """
    levels = section.levels[section.levels > 0]
    channels = section.basis.channels(levels, section.values)
    features = np.nan_to_num(channels[:, :-SCALING_COLUMNS])
    logs = np.clip(np.nan_to_num(channels[:, -SCALING_COLUMNS:]), -MAX_LOG_SIZE, MAX_LOG_SIZE)
    scalings = np.exp(logs) * expected
    offsets = section.basis.offsets(levels, section.offsets)
    return features, scalings, offsets.reshape(*section.masks.shape, 3), section.masks.astype(np.bool_)


def sizes_of(partial: Partial[AnchorScene]) -> SketchSizes:
    """Sizes of the scene."""
    return SketchSizes(partial.scene.num_elements, partial[AnchorLayout].feature_dim, partial[AnchorLayout].num_offsets)


def buckets_of(partial: Partial) -> np.ndarray:
    """Anchors by the size that the prior expects, int64 (N): integers on both ends, from numbers that are alike."""
    size = np.maximum(to_numpy(partial[Prior].scaling.mean)[:, 3:6].astype(np.float64), 0)
    return size_buckets(size[:, 0] * size[:, 1] * size[:, 2])
