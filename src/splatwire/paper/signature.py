"""What CARI knows about every anchor before it weighs neighbours: residuals, signature, uncertainty, context."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.model import Partial, Prior
from splatwire.scene import AnchorLayout, Anchors, Attribute


@dataclass(frozen=True)
class AttributeGroup:
    """Channels that share one set of weights.

    Attributes:
        attribute: What they are part of.
        part: Their place in `Residuals.parts`; the mask, which has votes instead of residuals, comes behind them.
    """

    attribute: Attribute
    part: int


def attribute_groups(layout: AnchorLayout) -> tuple[AttributeGroup, ...]:
    """The groups of the paper (feature groups, scaling, offsets), and the mask as the last one."""
    features = [Attribute.FEATURE] * len(layout.feature_groups)
    attributes = [*features, Attribute.SCALING, Attribute.OFFSET, Attribute.MASK]
    return tuple(AttributeGroup(attribute, part) for part, attribute in enumerate(attributes))


@dataclass(frozen=True, eq=False)
class Residuals:
    """Decoded minus predicted attributes (the paper's `r = y - mu`).

    Attributes:
        parts: Residuals of each feature group, the scalings and the offsets (offset-major), "N D" each. Zero where an
            attribute is missing (the prediction is all there is) and where an offset does not exist.
        exists: Offsets that have a residual.
    """

    parts: tuple[Tensor, ...]
    exists: Bool[Tensor, "N K"]


def residuals_of(context: Partial) -> Residuals:
    """Computes the residuals of what was received."""
    anchors, prior, received = context.scene.anchors, context[Prior], context.erasures.received
    exists = anchors.mask & received[:, int(Attribute.OFFSET), None] & received[:, int(Attribute.MASK), None]
    offset = (anchors.offsets - prior.offset.mean.view(anchors.offsets.shape)) * exists[:, :, None]
    feature = (anchors.features - prior.feature.mean) * received[:, int(Attribute.FEATURE), None]
    scaling = (anchors.scalings - prior.scaling.mean) * received[:, int(Attribute.SCALING), None]
    groups = (part.contiguous() for part in feature.split(context[AnchorLayout].feature_groups, dim=1))
    return Residuals((*groups, scaling, offset.flatten(1)), exists)


def signatures(residuals: Residuals) -> Float[Tensor, "N groups"]:
    """The compact signature `g`: mean residual of each feature group, of the scalings and of the existing offsets.

    An attribute that is missing counts with its zero residual, so an anchor of which nothing has arrived has the zero
    signature.
    """
    *means, offsets = residuals.parts
    existing = 3 * residuals.exists.sum(dim=1).clamp(min=1)
    return torch.stack([*(part.mean(dim=1) for part in means), offsets.sum(dim=1) / existing], dim=1)


def uncertainties(prior: Prior, layout: AnchorLayout) -> Float[Tensor, "N groups"]:
    """The scalar uncertainty `sigma` per group: the mean of the prior's scales; the mask shares that of the offsets."""
    columns = [part.mean(dim=1) for part in prior.feature.scale.split(layout.feature_groups, dim=1)]
    offset = prior.offset.scale.mean(dim=1)
    return torch.stack([*columns, prior.scaling.scale.mean(dim=1), offset, offset], dim=1)


def unit_rows(values: Float[Tensor, "N D"]) -> Float[Tensor, "N D"]:
    """Rows divided by their length, so that their products are cosines; rows shorter than 1e-30 become 0."""
    length = torch.linalg.vector_norm(values, dim=1, keepdim=True)
    return torch.where(length > 1e-30, values / length.clamp(min=1e-30), torch.zeros_like(values))


def anchors_from(context: Partial, residuals: Residuals, mask: Bool[Tensor, "N K"]) -> Anchors:
    """Adds residuals to the prior's mean: the paper's `A = mu + r`."""
    prior = context[Prior]
    *features, scaling, offset = residuals.parts
    return replace(
        context.scene.anchors,
        features=prior.feature.mean + torch.cat(features, dim=1),
        scalings=prior.scaling.mean + scaling,
        offsets=(prior.offset.mean + offset).view(context.scene.anchors.offsets.shape),
        mask=mask,
    )
