"""Small hand-made scenes with gaps."""

from dataclasses import replace

import torch

from splatwire.conceal import AnchorContext
from splatwire.model import AttributePrior, Prior
from splatwire.scene import AnchorLayout, Anchors, Erasures

LAYOUT = AnchorLayout(feature_dim=10, num_offsets=4, feature_groups=(2, 2, 2, 2, 2))
CONTEXT_DIM = 12


def random_context(
    num_anchors: int, seed: int, *, loss: float | int = 0.3, separated: bool = False, layout: AnchorLayout = LAYOUT
) -> AnchorContext:
    """Independent random numbers everywhere; attributes that were not received are zero, as a decoder returns them."""
    rng = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(num_anchors, *shape, generator=rng)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(num_anchors, *shape, generator=rng)

    known = uniform(4) >= loss if separated else (uniform() >= loss)[:, None].expand(-1, 4).clone()
    mask = (uniform(layout.num_offsets) < 0.5) & known[:, 3:4]
    anchors = Anchors(
        positions=normal(3),
        features=normal(layout.feature_dim) * known[:, 0:1],
        scalings=(0.1 + uniform(6)) * known[:, 1:2],
        offsets=normal(layout.num_offsets, 3) * (mask & known[:, 2:3])[:, :, None],
        mask=mask,
    )
    step = torch.ones(num_anchors, 1)
    prior = Prior(
        feature=AttributePrior(normal(layout.feature_dim), 0.1 + uniform(layout.feature_dim), step),
        scaling=AttributePrior(0.2 + uniform(6), 0.05 + uniform(6), step),
        offset=AttributePrior(normal(3 * layout.num_offsets), 0.1 + uniform(3 * layout.num_offsets), step),
        context=normal(CONTEXT_DIM),
    )
    return AnchorContext(anchors, Erasures(known), prior, layout)


def permuted(context: AnchorContext, order: torch.Tensor) -> AnchorContext:
    prior = context.prior
    parts = (
        AttributePrior(part.mean[order], part.scale[order], part.step[order])
        for part in (prior.feature, prior.scaling, prior.offset)
    )
    return AnchorContext(
        context.anchors.select(order),
        Erasures(context.erasures.received[order]),
        Prior(*parts, context=prior.context[order]),
        context.layout,
    )


def only(context: AnchorContext, known: torch.Tensor) -> AnchorContext:
    """The context of a receiver to whom only some anchors came, all of their attributes."""
    a, blank = context.anchors, known[:, None]
    anchors = Anchors(
        a.positions, a.features * blank, a.scalings * blank, a.offsets * blank[:, :, None], a.mask & blank
    )
    return replace(context, anchors=anchors, erasures=Erasures.of_anchors(known))
