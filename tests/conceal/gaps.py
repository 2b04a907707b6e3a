"""Small hand-made scenes with gaps."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from splatwire.model import (
    AnchorScene,
    AttributePrior,
    ContextModel,
    GaussianHeads,
    HacppCoding,
    HashGrid,
    Linear,
    Mlp,
    ModelConfig,
    Partial,
    Prior,
    SplatScene,
)
from splatwire.scene import AnchorLayout, Anchors, Erasures
from splatwire.scene.splats import Splats

LAYOUT = AnchorLayout(feature_dim=10, num_offsets=4, feature_groups=(2, 2, 2, 2, 2))
CONTEXT_DIM = 12


def random_context(
    num_anchors: int, seed: int, *, loss: float | int = 0.3, separated: bool = False, layout: AnchorLayout = LAYOUT
) -> Partial:
    """Independent random numbers everywhere; attributes that were not received are zero, as a decoder returns them."""
    rng = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> np.ndarray:
        return torch.randn(num_anchors, *shape, generator=rng).numpy()

    def uniform(*shape: int) -> np.ndarray:
        return torch.rand(num_anchors, *shape, generator=rng).numpy()

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
        context=normal(CONTEXT_DIM),
    )
    return partial_of(anchors, Erasures(known), prior, layout)


def partial_of(anchors: Anchors, erasures: Erasures, *said: Any) -> Partial:
    """A decoded scene of these anchors, whose networks say nothing."""
    mlp = Mlp(
        Linear(np.zeros((1, 1), np.float32), np.zeros(1, np.float32)),
        Linear(np.zeros((1, 1), np.float32), np.zeros(1, np.float32)),
    )
    signs = np.ones((1, 1), np.int8)
    model = ContextModel(
        HashGrid(signs, np.ones((3, 1, 1), np.int8), np.zeros(3, np.float32), np.ones(3, np.float32)), mlp, (mlp,)
    )
    layout = next(record for record in said if isinstance(record, AnchorLayout))
    coding = HacppCoding(model, 0.001, ModelConfig(layout=layout))
    return Partial(AnchorScene(anchors, GaussianHeads(mlp, mlp, mlp), coding), erasures, {}, said)


def changed(context: Partial, **fields: Any) -> Partial:
    """The same with other anchors, erasures, prior or sections, or with other fields of its anchors."""
    anchors = fields.pop("anchors", context.elements)
    said = [fields.pop("prior")] if "prior" in fields else []
    own = {name: fields.pop(name) for name in list(fields) if name in vars(anchors)}
    scene = context.scene.with_elements(replace(anchors, **own))
    return replace(context, scene=scene, **fields).saying(*said)


def permuted(context: Partial, order: np.ndarray) -> Partial:
    prior = context[Prior]
    parts = (
        AttributePrior(part.mean[order], part.scale[order], part.step[order])
        for part in (prior.feature, prior.scaling, prior.offset)
    )
    return partial_of(
        context.scene.anchors.select(order),
        Erasures(context.erasures.received[order]),
        Prior(*parts, context=prior.context[order]),
        context[AnchorLayout],
    )


def only(context: Partial, known: np.ndarray) -> Partial:
    """The context of a receiver to whom only some anchors came, all of their attributes."""
    a, blank = context.scene.anchors, known[:, None]
    anchors = Anchors(
        a.positions, a.features * blank, a.scalings * blank, a.offsets * blank[:, :, None], a.mask & blank
    )
    return changed(context, anchors=anchors, erasures=Erasures.of_anchors(known))


def gaussians(
    positions: np.ndarray, opacities: np.ndarray, known: np.ndarray, log_scales: np.ndarray | None = None
) -> Partial:
    """Explicit Gaussians, of size 1 unless said otherwise."""
    count = len(positions)
    scales = np.ones((count, 3), np.float32) if log_scales is None else np.exp(log_scales)
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (count, 1))
    splats = Splats(positions, quats, scales, opacities, np.zeros((count, 1, 3), np.float32))
    return Partial(SplatScene(splats), Erasures.of_anchors(known))
