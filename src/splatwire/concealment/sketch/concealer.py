"""The concealer `sketch`: draws lost elements from coarse copies that the sender added to the side information."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import CheckedFields
from splatwire.concealment.base import Concealed
from splatwire.concealment.grow import Grow
from splatwire.concealment.registry import register_concealer
from splatwire.concealment.scene_free.elements import GaussianInputs, enlarge_received, gaussian_inputs
from splatwire.concealment.scene_free.network import AnchorInputs, anchor_inputs
from splatwire.concealment.scene_free.signature import near_losses
from splatwire.concealment.scene_free.surroundings import surroundings_of
from splatwire.concealment.scene_free.weights import default_anchor_weights, default_gaussian_weights
from splatwire.concealment.sketch.section import (
    SCALING_COLUMNS,
    SECTION,
    SketchSection,
    SketchSizes,
    read_sketch,
    size_buckets,
)
from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import lower_median, to_arrays, to_numpy
from splatwire.types import AnchorLayout, AnchorScene, Attribute, Copies, LossMask, Prior, ReceivedScene, SplatScene
from splatwire.types.splats import Splats

MAX_LOG_SIZE = 6.0
"""Limit of decoded log scalings relative to the prior: for any data, scalings stay within a factor of `exp(6)` of the
predicted scalings."""
_MIN_SHARE = 0.05


@register_concealer("sketch", section=SECTION)
@dataclass(frozen=True)
class Sketch(CheckedFields):
    """Concealer that draws coarse copies of the most important lost elements.

    The sender adds the copies (the sketch) to the side information: `splatwire encode --preset datagram` or
    `splatwire calibrate sketch`. Lost elements without a copy are hidden, and drawn elements around them are
    enlarged.
    """

    @property
    def name(self) -> str:
        """Name of this concealer in the registry, `sketch`."""
        return "sketch"

    def __call__(self, received: ReceivedScene) -> Concealed:
        """Draws coarse copies of lost elements. Lost elements without a copy are hidden; their neighbours are enlarged.

        Raises:
            InvalidValueError: If the stream has no section `sketch`, which contains the coarse copies.
            BitstreamError: If the section is damaged or belongs to another scene.
        """
        copies = received.get(Copies)
        if copies is not None:
            return conceal_with_copies(received, copies)
        if SECTION not in received.sections:
            raise _missing()
        section = read_sketch(received.sections[SECTION], sizes_of(received), buckets_of(received))
        return conceal_with(received, section)


def _missing() -> InvalidValueError:
    return InvalidValueError(
        f"concealer 'sketch' needs the section '{SECTION}', which this stream does not have: add it with "
        "`splatwire calibrate sketch`, or use 'grow'"
    )


def conceal_with(received: ReceivedScene[AnchorScene], section: SketchSection) -> Concealed:
    """Draws coarse copies in place of lost anchors, hides lost anchors without a copy, and enlarges their neighbours.

    Args:
        received: The received scene.
        section: The copies, and the parameters of the enlargement.
    """
    sketched = with_sketch(received, section)
    if section.trust and bool(sketched.fully_received.any()):
        return SketchedLoss.of(sketched).conceal(section)
    grow = Grow(exponent=section.exponent, max_excess=section.max_excess)
    return replace(grow(sketched), elements=sketched.filled)


def conceal_with_copies(received: ReceivedScene[SplatScene], copies: Copies) -> Concealed:
    """Replaces lost Gaussians by coarse copies, hides the other lost Gaussians, and enlarges Gaussians next to gaps."""
    sketched = with_copies(received, copies)
    return grown_with_copies(sketched, gaussian_inputs(sketched), copies.growth)


def grown_with_copies(
    sketched: ReceivedScene[SplatScene], inputs: GaussianInputs, growth: tuple[float, float, float]
) -> Concealed:
    """Leaves out lost Gaussians that have no coarse copy, and enlarges the Gaussians around them.

    Args:
        sketched: Received scene in which copies have replaced lost Gaussians.
        inputs: Inputs of the network that corrects the enlargement.
        growth: Parameters of the enlargement (`Copies.growth`): exponents of size and opacity, weight of the network.
    """
    size, opacity, trust = growth
    gains = default_gaussian_weights()(inputs, trust, (size, opacity))
    return replace(enlarge_received(sketched, inputs.rows, gains), elements=sketched.elements)


def with_copies(received_scene: ReceivedScene[SplatScene], copies: Copies) -> ReceivedScene[SplatScene]:
    """Returns the scene with lost Gaussians replaced by their copies and marked as received."""
    lost = ~received_scene.fully_received[copies.indices]
    indices, chosen = copies.indices[lost], copies.splats.select(lost)
    splats = {name: values.copy() for name, values in vars(received_scene.scene.splats).items()}
    for name, values in splats.items():
        values[indices] = getattr(chosen, name)
    received = received_scene.loss_mask.received.copy()
    received[indices] = True
    return replace(
        received_scene, scene=received_scene.scene.with_elements(Splats(**splats)), loss_mask=LossMask(received)
    )


@dataclass(frozen=True, eq=False)
class SketchedLoss:
    """Received scene in which copies have replaced lost anchors, and data for enlarging the M drawn anchors.

    Attributes:
        received_scene: The scene; an anchor with a copy counts as received. At least one anchor is drawn.
        drawn_share: For each drawn anchor, fraction of its neighbours that are drawn, 0 to 1.
        inputs: Inputs of the network that corrects the enlargement.
    """

    received_scene: ReceivedScene[AnchorScene]
    drawn_share: Float[np.ndarray, "M"]
    inputs: AnchorInputs

    @staticmethod
    def of(sketched: ReceivedScene[AnchorScene]) -> "SketchedLoss":
        """Computes the data for enlarging drawn anchors, given a scene in which copies have replaced lost anchors."""
        around = surroundings_of(sketched, np.flatnonzero(sketched.fully_received))
        return SketchedLoss(sketched, 1 - near_losses(sketched, around), anchor_inputs(sketched, around))

    def conceal(self, section: SketchSection) -> Concealed:
        """Hides those lost anchors that have no coarse copy, and enlarges drawn anchors next to hidden ones.

        Args:
            section: The decoded section `sketch`, with the parameters of the enlargement and the coarse copies.
        """
        rule, scene = Grow(exponent=section.exponent, max_excess=section.max_excess), self.received_scene
        gain = rule.gain(self.drawn_share, scene.fully_received, scene.tier_sizes)
        gains = default_anchor_weights()(replace(self.inputs, grown=gain), section.trust)
        return replace(enlarge_received(scene, self.inputs.rows, gains), elements=scene.filled)


def with_sketch(received_scene: ReceivedScene[AnchorScene], section: SketchSection) -> ReceivedScene[AnchorScene]:
    """Returns the scene with lost anchors replaced by coarse copies, which are marked as received."""
    anchors, received = to_arrays(received_scene.scene.anchors), received_scene.loss_mask.received
    drawn = section.levels > 0
    rows = np.flatnonzero(drawn)
    features, scalings, offsets, mask = sketched_attributes(section, expected_scalings(received_scene[Prior])[rows])

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
    loss_mask = LossMask(received | drawn[:, None])
    return replace(received_scene, scene=received_scene.scene.with_elements(filled), loss_mask=loss_mask)


def expected_scalings(prior: Prior) -> Float[np.ndarray, "N 6"]:
    """Returns the scalings of anchors as predicted from the hash grid, raised to a minimum above 0.

    The minimum of each of the six columns is a fixed fraction of the column's median over all anchors.
    """
    mean = to_numpy(prior.scaling.mean)
    floor = np.float32(_MIN_SHARE) * lower_median(mean) if len(mean) else np.zeros(6, np.float32)
    return np.maximum(np.maximum(mean, floor), np.float32(1e-9))


def sketched_attributes(
    section: SketchSection, expected: Float[np.ndarray, "M 6"]
) -> tuple[Float[np.ndarray, "M F"], Float[np.ndarray, "M 6"], Float[np.ndarray, "M K 3"], Bool[np.ndarray, "M K"]]:
    """Returns features, scalings, offsets and offset masks of the M coarse copies in a sketch.

    Args:
        section: The sketch.
        expected: Scalings of the anchors with a copy, as predicted from the hash grid. The sketch codes each scaling as
            a factor on its prediction.
    """
    levels = section.levels[section.levels > 0]
    channels = section.basis.channels(levels, section.values)
    features = np.nan_to_num(channels[:, :-SCALING_COLUMNS])
    logs = np.clip(np.nan_to_num(channels[:, -SCALING_COLUMNS:]), -MAX_LOG_SIZE, MAX_LOG_SIZE)
    scalings = np.exp(logs) * expected
    offsets = section.basis.offsets(levels, section.offsets)
    return features, scalings, offsets.reshape(*section.masks.shape, 3), section.masks.astype(np.bool_)


def sizes_of(received: ReceivedScene[AnchorScene]) -> SketchSizes:
    """Returns the numbers of anchors, feature channels and offsets of a received scene."""
    return SketchSizes(
        received.scene.num_elements, received[AnchorLayout].feature_dim, received[AnchorLayout].num_offsets
    )


def buckets_of(received: ReceivedScene) -> np.ndarray:
    """Returns the size class of each anchor of a received scene, 0 for the largest, int64 (N).

    The class is computed from sizes that are predicted from the hash grid, so encoder and decoder obtain the same
    class. It selects the context of the entropy coder for the copies of anchors in a sketch.
    """
    size = np.maximum(to_numpy(received[Prior].scaling.mean)[:, 3:6].astype(np.float64), 0)
    return size_buckets(size[:, 0] * size[:, 1] * size[:, 2])
