"""Converts the network's outputs for lost anchors to attribute values.

The output is blended with the interpolation, or replaced by the interpolation if the confidence is too low. Source:
Section 3.4 of the paper (`docs/paper-map.md`).
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.paper.gnn.network import RawResiduals
from splatwire.paper.gnn.settings import GnnSettings
from splatwire.types import Anchors, AttributePrior, Prior

EPSILON = 1e-6
"""Added to the prior's standard deviations before division by them."""


@dataclass(frozen=True, eq=False)
class Branch:
    """Two estimates of one attribute (feature, scaling or offset) of Q lost anchors: by a GNN and by interpolation.

    The GNN outputs a residual for each of the D values of the attribute. The residual is relative to a baseline: the
    mean that the hash grid predicts, or the interpolated value.

    Attributes:
        predicted: Estimate of the GNN: baseline plus `confidence` times residual.
        interpolated: Estimate by interpolation from neighbours.
        confidence: Confidence in the estimate of the GNN, 0 to 1. It is `exp(-alpha * z)`: z is the mean absolute
            residual in standard deviations of `prior`, and alpha is `GnnSettings.sharpness`.
        prior: Mean and standard deviation that the hash grid predicts for each value.
    """

    predicted: Float[Tensor, "Q D"]
    interpolated: Float[Tensor, "Q D"]
    confidence: Float[Tensor, "Q 1"]
    prior: AttributePrior

    def fused(self, threshold: float) -> Float[Tensor, "Q D"]:
        """Returns the final values of the attribute for each lost anchor (query).

        Where the confidence is at least `threshold`, the estimates of network and interpolation are blended. Elsewhere,
        the interpolation is used.
        """
        # The paper's soft blend: c times the network's estimate plus 1 - c times the interpolation.
        blend = self.confidence * self.predicted + (1 - self.confidence) * self.interpolated
        return torch.where(self.confidence >= threshold, blend, self.interpolated)


@dataclass(frozen=True, eq=False)
class Branches:
    """Two estimates of the attributes of Q lost anchors: one by a GNN and one by interpolation from neighbours.

    Attributes:
        feature: Estimates of the features.
        scaling: Estimates of the scalings.
        offset: Estimates of the offsets.
        mask_logit: Logits of the GNN for each of the K offsets of an anchor. An offset exists if its logit is 0 or
            more.
    """

    feature: Branch
    scaling: Branch
    offset: Branch
    mask_logit: Float[Tensor, "Q K"]

    def continuous(self) -> tuple[tuple[str, Branch], ...]:
        """Returns the estimates of features, scalings and offsets, each with the name of the attribute."""
        return ("feature", self.feature), ("scaling", self.scaling), ("offset", self.offset)


def branches(raw: RawResiduals, prior: Prior, interpolated: Anchors, settings: GnnSettings) -> Branches:
    """Converts outputs of the network to estimates of the attributes of lost anchors.

    Args:
        raw: Outputs of the network for the lost anchors.
        prior: Distributions that the hash grid predicts for these anchors.
        interpolated: The same anchors with attributes interpolated from their neighbours.
        settings: Settings of the network.
    """
    # The network's residuals are clipped, multiplied by the confidence and added to the baseline.
    # an offset that the interpolation masks out has no interpolated position; the prior's mean is used instead
    exists = interpolated.mask.repeat_interleave(3, dim=1)
    offsets = torch.where(exists, interpolated.offsets.flatten(1), prior.offset.mean)
    return Branches(
        _branch(raw.feature, prior.feature, interpolated.features, settings),
        _branch(raw.scaling, prior.scaling, interpolated.scalings, settings),
        _branch(raw.offset, prior.offset, offsets, settings),
        raw.mask_logit,
    )


def _branch(
    residual: Float[Tensor, "Q D"], prior: AttributePrior, interpolated: Float[Tensor, "Q D"], settings: GnnSettings
) -> Branch:
    z = residual.clamp(-settings.clip, settings.clip)
    step = z * prior.scale
    deviation = (step / (prior.scale + EPSILON)).abs().mean(dim=1, keepdim=True)
    confidence = torch.exp(-settings.sharpness * deviation)
    baseline = prior.mean if settings.baseline == "prior" else interpolated
    return Branch(baseline + confidence * step, interpolated, confidence, prior)


def fuse(estimates: Branches, interpolated: Anchors, settings: GnnSettings) -> Anchors:
    """Computes the final attributes of lost anchors (queries) from the network's and the interpolation's estimates.

    Args:
        estimates: Estimates of the network and of the interpolation.
        interpolated: The queries with attributes filled by the interpolation.
        settings: Settings of the network.

    Returns:
        The concealed anchors.
    """
    # Where the network's confidence reaches the attribute's threshold, both estimates are blended (`Branch.fused`).
    # Elsewhere, the interpolated value is used. The offset masks follow the confidence of the offsets. With all
    # thresholds above 1, the result equals `interpolated` bit for bit.
    offset = estimates.offset.fused(settings.offset_threshold).view(interpolated.offsets.shape)
    trusted = estimates.offset.confidence >= settings.offset_threshold
    mask = torch.where(trusted, estimates.mask_logit >= 0, interpolated.mask)
    return replace(
        interpolated,
        features=estimates.feature.fused(settings.feature_threshold),
        scalings=estimates.scaling.fused(settings.scaling_threshold),
        offsets=torch.where(trusted[:, :, None], offset * mask[:, :, None], interpolated.offsets),
        mask=mask,
    )
