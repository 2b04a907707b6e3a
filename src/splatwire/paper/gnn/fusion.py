"""From raw residuals to attributes: clip, confidence, soft blend, hard fallback (paper, Section 3.4)."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.model import AttributePrior, Prior
from splatwire.paper.gnn.network import RawResiduals
from splatwire.paper.gnn.settings import GnnSettings
from splatwire.scene import Anchors

EPSILON = 1e-6
"""Added to prior scales."""


@dataclass(frozen=True, eq=False)
class Branch:
    """One continuous attribute of some queries.

    Attributes:
        predicted: The network's estimate `b + c * residual`.
        interpolated: The interpolation's.
        confidence: `c = exp(-alpha z)` with z the mean residual in prior standard deviations, 0 to 1.
        prior: What the hash grid says.
    """

    predicted: Float[Tensor, "Q D"]
    interpolated: Float[Tensor, "Q D"]
    confidence: Float[Tensor, "Q 1"]
    prior: AttributePrior

    def fused(self, threshold: float) -> Float[Tensor, "Q D"]:
        """The paper's soft blend where the confidence reaches the threshold, exactly the interpolation elsewhere."""
        blend = self.confidence * self.predicted + (1 - self.confidence) * self.interpolated
        return torch.where(self.confidence >= threshold, blend, self.interpolated)


@dataclass(frozen=True, eq=False)
class Branches:
    """All attributes of some queries."""

    feature: Branch
    scaling: Branch
    offset: Branch
    mask_logit: Float[Tensor, "Q K"]

    def continuous(self) -> tuple[tuple[str, Branch], ...]:
        """The three regressed attributes with their names."""
        return ("feature", self.feature), ("scaling", self.scaling), ("offset", self.offset)


def branches(raw: RawResiduals, prior: Prior, interpolated: Anchors, settings: GnnSettings) -> Branches:
    """Clips residuals, gates them and adds them to the baseline.

    Args:
        raw: What the heads say.
        prior: Prior of the queries.
        interpolated: Interpolation of the queries.
        settings: Clip, sharpness and baseline.
    """
    # An offset that the interpolation leaves out has no interpolated place; the prior's is the best there is.
    exists = interpolated.mask.repeat_interleave(3, dim=1)
    places = torch.where(exists, interpolated.offsets.flatten(1), prior.offset.mean)
    return Branches(
        _branch(raw.feature, prior.feature, interpolated.features, settings),
        _branch(raw.scaling, prior.scaling, interpolated.scalings, settings),
        _branch(raw.offset, prior.offset, places, settings),
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


def fuse(parts: Branches, interpolated: Anchors, settings: GnnSettings) -> Anchors:
    """Decides per query and attribute between blend and interpolation.

    Returns:
        The queries. With all thresholds above 1 these are `interpolated`, bit for bit.
    """
    offset = parts.offset.fused(settings.offset_threshold).view(interpolated.offsets.shape)
    trusted = parts.offset.confidence >= settings.offset_threshold
    mask = torch.where(trusted, parts.mask_logit >= 0, interpolated.mask)
    return replace(
        interpolated,
        features=parts.feature.fused(settings.feature_threshold),
        scalings=parts.scaling.fused(settings.scaling_threshold),
        offsets=torch.where(trusted[:, :, None], offset * mask[:, :, None], interpolated.offsets),
        mask=mask,
    )
