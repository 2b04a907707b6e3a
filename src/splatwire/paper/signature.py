"""Quantities that CARI (Context-Aware Residual Interpolation) computes for each anchor.

Residuals are differences from the predictions of the hash grid. A signature has the mean residual of each group of
attribute channels. The uncertainty is the mean standard deviation of the hash grid's predictions for a group.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.types import AnchorLayout, Anchors, Attribute, Prior, ReceivedScene


@dataclass(frozen=True)
class AttributeGroup:
    """Channels of an anchor attribute, such as a feature group, that are interpolated with the same neighbours.

    Attributes:
        attribute: The attribute that the channels belong to.
        part: Index of the group.
    """

    # It is also the index in `Residuals.parts`. The group of the offset masks is last and has no residuals.

    attribute: Attribute
    part: int


def attribute_groups(layout: AnchorLayout) -> tuple[AttributeGroup, ...]:
    """Returns the attribute groups of an anchor: one for each feature group, then scalings, offsets and mask."""
    features = [Attribute.FEATURE] * len(layout.feature_groups)
    attributes = [*features, Attribute.SCALING, Attribute.OFFSET, Attribute.MASK]
    return tuple(AttributeGroup(attribute, part) for part, attribute in enumerate(attributes))


@dataclass(frozen=True, eq=False)
class Residuals:
    """Decoded minus predicted attributes (the paper's `r = y - mu`).

    Attributes:
        parts: Residuals of N anchors: one tensor (N, D) for each feature group, then one for the scalings and one for
            the offsets. Order of the offsets: x, y, z of the first one, then of the second, and so on.
        exists: True for offsets that have a residual.
    """

    # Residuals are zero for missing attributes and for offsets that do not exist.

    parts: tuple[Tensor, ...]
    exists: Bool[Tensor, "N K"]


def residuals_of(context: ReceivedScene) -> Residuals:
    """Subtracts the prior's mean from each received attribute; lost attributes get zero."""
    # An offset counts as received only if the anchor's offset mask was received too.
    anchors, prior, received = context.scene.anchors, context[Prior], context.loss_mask.received
    exists = anchors.mask & received[:, int(Attribute.OFFSET), None] & received[:, int(Attribute.MASK), None]
    offset = (anchors.offsets - prior.offset.mean.view(anchors.offsets.shape)) * exists[:, :, None]
    feature = (anchors.features - prior.feature.mean) * received[:, int(Attribute.FEATURE), None]
    scaling = (anchors.scalings - prior.scaling.mean) * received[:, int(Attribute.SCALING), None]
    groups = (part.contiguous() for part in feature.split(context[AnchorLayout].feature_groups, dim=1))
    return Residuals((*groups, scaling, offset.flatten(1)), exists)


def signatures(residuals: Residuals) -> Float[Tensor, "N groups"]:
    """Returns the signature `g` of each anchor (paper): mean residual of each attribute group."""
    # CARI compares signatures by cosine similarity. Missing attributes have residual zero, so a completely lost
    # anchor has the zero signature.
    *means, offsets = residuals.parts
    existing = 3 * residuals.exists.sum(dim=1).clamp(min=1)
    return torch.stack([*(part.mean(dim=1) for part in means), offsets.sum(dim=1) / existing], dim=1)


def uncertainties(prior: Prior, layout: AnchorLayout) -> Float[Tensor, "N groups"]:
    """Returns the paper's uncertainty `sigma` of each anchor, one number per attribute group.

    It is the mean of the prior's standard deviations over the channels of the group.
    """
    # The mask, which has no prior, has the uncertainty of the offsets.
    columns = [part.mean(dim=1) for part in prior.feature.scale.split(layout.feature_groups, dim=1)]
    offset = prior.offset.scale.mean(dim=1)
    return torch.stack([*columns, prior.scaling.scale.mean(dim=1), offset, offset], dim=1)


def unit_rows(values: Float[Tensor, "N D"]) -> Float[Tensor, "N D"]:
    """Normalises each row of a matrix to length 1."""
    # Rows shorter than 1e-30 become 0.
    length = torch.linalg.vector_norm(values, dim=1, keepdim=True)
    return torch.where(length > 1e-30, values / length.clamp(min=1e-30), torch.zeros_like(values))


def anchors_from(context: ReceivedScene, residuals: Residuals, mask: Bool[Tensor, "N K"]) -> Anchors:
    """Adds residuals to the attributes that the hash grid predicts, and returns the resulting anchors.

    This is `A = mu + r` in the paper, with the predicted mean mu.

    Args:
        context: The received scene with its prior.
        residuals: Received or interpolated residuals of all anchors.
        mask: Offset masks of the result.
    """
    prior = context[Prior]
    *features, scaling, offset = residuals.parts
    return replace(
        context.scene.anchors,
        features=prior.feature.mean + torch.cat(features, dim=1),
        scalings=prior.scaling.mean + scaling,
        offsets=(prior.offset.mean + offset).view(context.scene.anchors.offsets.shape),
        mask=mask,
    )
