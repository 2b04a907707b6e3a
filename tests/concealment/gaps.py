"""Small hand-made scenes with lost elements."""

from dataclasses import replace
from typing import Any

import numpy as np

from random_numbers import Numbers
from splatwire.types import (
    AnchorLayout,
    Anchors,
    AnchorScene,
    AttributePrior,
    GaussianHeads,
    HacppCoding,
    HacppConfig,
    HacppContextModel,
    HashGrid,
    Linear,
    LossMask,
    Mlp,
    Prior,
    ReceivedScene,
    SplatScene,
)
from splatwire.types.splats import Splats

LAYOUT = AnchorLayout(feature_dim=10, num_offsets=4, feature_groups=(2, 2, 2, 2, 2))
CONTEXT_DIM = 12


def random_context(
    num_anchors: int, seed: int, *, loss: float | int = 0.3, separated: bool = False, layout: AnchorLayout = LAYOUT
) -> ReceivedScene:
    """Fills attributes with independent random numbers.

    Attributes that are not received are zero, as from a decoder.
    """
    rng = Numbers(seed)

    def normal(*shape: int) -> np.ndarray:
        return rng.randn(num_anchors, *shape)

    def uniform(*shape: int) -> np.ndarray:
        return rng.rand(num_anchors, *shape)

    known = uniform(4) >= loss if separated else np.repeat((uniform() >= loss)[:, None], 4, axis=1)
    mask = (uniform(layout.num_offsets) < 0.5) & known[:, 3:4]
    anchors = Anchors(
        positions=normal(3),
        features=normal(layout.feature_dim) * known[:, 0:1],
        scalings=(0.1 + uniform(6)) * known[:, 1:2],
        offsets=normal(layout.num_offsets, 3) * (mask & known[:, 2:3])[:, :, None],
        mask=mask,
    )
    step = np.ones((num_anchors, 1), np.float32)
    prior = Prior(
        feature=AttributePrior(normal(layout.feature_dim), 0.1 + uniform(layout.feature_dim), step),
        scaling=AttributePrior(0.2 + uniform(6), 0.05 + uniform(6), step),
        offset=AttributePrior(normal(3 * layout.num_offsets), 0.1 + uniform(3 * layout.num_offsets), step),
        context_features=normal(CONTEXT_DIM),
    )
    return partial_of(anchors, LossMask(known), prior, layout)


def partial_of(anchors: Anchors, loss_mask: LossMask, *records: Any) -> ReceivedScene:
    """Decoded scene of some anchors, with networks of constant outputs."""
    mlp = Mlp(
        Linear(np.zeros((1, 1), np.float32), np.zeros(1, np.float32)),
        Linear(np.zeros((1, 1), np.float32), np.zeros(1, np.float32)),
    )
    signs = np.ones((1, 1), np.int8)
    model = HacppContextModel(
        HashGrid(signs, np.ones((3, 1, 1), np.int8), np.zeros(3, np.float32), np.ones(3, np.float32)), mlp, (mlp,)
    )
    layout = next(record for record in records if isinstance(record, AnchorLayout))
    coding = HacppCoding(model, 0.001, HacppConfig(layout=layout))
    return ReceivedScene(AnchorScene(anchors, GaussianHeads(mlp, mlp, mlp), coding), loss_mask, {}, records)


def changed(context: ReceivedScene, **fields: Any) -> ReceivedScene:
    """Copy of a received scene with other anchors, loss mask, prior, sections or attributes of the anchors."""
    anchors = fields.pop("anchors", context.elements)
    records = [fields.pop("prior")] if "prior" in fields else []
    own = {name: fields.pop(name) for name in list(fields) if name in vars(anchors)}
    scene = context.scene.with_elements(replace(anchors, **own))
    return replace(context, scene=scene, **fields).with_records(*records)


def permuted(context: ReceivedScene, order: np.ndarray) -> ReceivedScene:
    prior = context[Prior]
    parts = (
        AttributePrior(part.mean[order], part.scale[order], part.step[order])
        for part in (prior.feature, prior.scaling, prior.offset)
    )
    return partial_of(
        context.scene.anchors.select(order),
        LossMask(context.loss_mask.received[order]),
        Prior(*parts, context_features=prior.context_features[order]),
        context[AnchorLayout],
    )


def only(context: ReceivedScene, known: np.ndarray) -> ReceivedScene:
    """Received scene that has only some anchors, with all their attributes."""
    a, blank = context.scene.anchors, known[:, None]
    anchors = Anchors(
        a.positions, a.features * blank, a.scalings * blank, a.offsets * blank[:, :, None], a.mask & blank
    )
    return changed(context, anchors=anchors, loss_mask=LossMask.of_elements(known))


def gaussians(
    positions: np.ndarray, opacities: np.ndarray, known: np.ndarray, log_scales: np.ndarray | None = None
) -> ReceivedScene:
    """Explicit Gaussians, of size 1 by default."""
    count = len(positions)
    scales = np.ones((count, 3), np.float32) if log_scales is None else np.exp(log_scales)
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (count, 1))
    splats = Splats(positions, quats, scales, opacities, np.zeros((count, 1, 3), np.float32))
    return ReceivedScene(SplatScene(splats), LossMask.of_elements(known))
