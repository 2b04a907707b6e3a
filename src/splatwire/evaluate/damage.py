"""What losing each tier of importance does to the picture: the numbers that a planner splits a budget by."""

import dataclasses
from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from splatwire.conceal import conceal
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, PartialScene
from splatwire.render import iterate_views
from splatwire.scene import Anchors, Cameras, Erasures
from splatwire.transport.planner import Damage

SHARES = (0.0, 0.1, 0.3, 1.0)
ASSUMED_BASE_MSE = 1e-3
"""Of a scene that shows its photos at 30 dB; taken where nobody has photos."""


def measure_damage(
    complete: PartialScene,
    tiers: UInt8[Tensor, "N"],
    cameras: Cameras,
    *,
    concealer: str,
    shares: tuple[float, ...] = SHARES,
    base_mse: float = ASSUMED_BASE_MSE,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Damage:
    """Loses shares of one tier at a time, conceals, draws, and compares with the complete scene.

    Args:
        complete: A decoded stream that lost nothing.
        tiers: Tier of every anchor.
        cameras: Where from; a few views are enough.
        concealer: What the receiver will use.
        shares: Lost shares that are tried, ascending from 0.
        base_mse: Mean squared error of the complete scene against photos.
        seed: Which anchors are lost.
        progress: Called with the share of the work that is done.

    Returns:
        The damage; what measured less than a smaller loss of the same tier is raised to it.

    Raises:
        InvalidValueError: If the stream lost something.
        UnknownNameError: No concealer has that name.
    """
    if complete.erasures.num_lost:
        raise InvalidValueError(f"damage needs a complete stream, and {complete.erasures.num_lost} anchors are lost")
    references = list(iterate_views(complete.scene, cameras))
    order = torch.rand(len(tiers), generator=torch.Generator().manual_seed(seed)).argsort()
    num_tiers = int(tiers.max()) + 1
    mse = np.zeros((num_tiers, len(shares)))
    for tier in range(num_tiers):
        members = order[tiers[order] == tier]
        for s, share in enumerate(shares[1:], start=1):
            known = torch.ones(len(tiers), dtype=torch.bool)
            known[members[: round(share * len(members))]] = False
            scene = conceal(without(complete, known), concealer)
            mse[tier, s] = _error(scene, cameras, references)
            if progress:
                progress((tier * (len(shares) - 1) + s) / (num_tiers * (len(shares) - 1)))
    return Damage(np.array(shares), np.maximum.accumulate(mse, axis=1), base_mse)


def without(complete: PartialScene, known: Bool[Tensor, "N"]) -> PartialScene:
    """The same scene with anchors lost, as if their packets had not come."""
    anchors = complete.scene.anchors

    def gap(values: Tensor) -> Tensor:
        return torch.where(known.view(-1, *[1] * (values.dim() - 1)), values, torch.zeros_like(values))

    there = Anchors(
        anchors.positions, gap(anchors.features), gap(anchors.scalings), gap(anchors.offsets), gap(anchors.mask)
    )
    scene = dataclasses.replace(complete.scene, anchors=there)
    return dataclasses.replace(complete, scene=scene, erasures=Erasures.of_anchors(known))


def _error(scene: AnchorScene, cameras: Cameras, references: list[Tensor]) -> float:
    pictures = iterate_views(scene, cameras)
    errors = [
        float((image - truth).double().square().mean()) for image, truth in zip(pictures, references, strict=True)
    ]
    return float(np.mean(errors))
