"""The network as a concealer."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import torch

from splatwire.conceal.base import Concealed
from splatwire.conceal.registry import register_concealer
from splatwire.errors import InvalidValueError
from splatwire.model import Partial, Prior
from splatwire.model.prior import plausible_scalings
from splatwire.model.tensors import to_tensors
from splatwire.paper.gnn.fusion import branches, fuse
from splatwire.paper.gnn.graph import RepairGraph, build_graph, interpolator, prior_rows, query_inputs, source_inputs
from splatwire.paper.gnn.network import InpaintingNetwork
from splatwire.paper.gnn.section import SECTION, read_section
from splatwire.paper.gnn.weights import GnnWeights, check_fits, load_weights
from splatwire.scene import Anchors

_CHUNK = 768
"""Queries at a time: their edges stay in cache."""
_SOURCE_CHUNK = 1 << 13


@register_concealer("gnn", needs=[Prior], option="weights", section=SECTION)
@dataclass(frozen=True)
class Gnn:
    """The paper's prior-aware GNN residual inpainting, with weights that were calibrated on the scene.

    Fallbacks: where nothing is known there is no graph, and the interpolation's own fallback, the prior's mean, is
    taken; with fewer than k known anchors all of them are neighbours; where the network says something that is not
    finite, the interpolation is taken.

    Attributes:
        weights: A file that `splatwire calibrate gnn` wrote, or its content; None for those that the stream carries.
    """

    weights: str | Path | GnnWeights | None = None
    loaded: GnnWeights | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        known = self.weights is None or isinstance(self.weights, GnnWeights)
        object.__setattr__(self, "loaded", self.weights if known else load_weights(Path(str(self.weights))))

    @property
    def name(self) -> str:
        """`gnn`."""
        return "gnn"

    def __call__(self, context: Partial) -> Concealed:
        """See `Concealer`.

        Raises:
            InvalidValueError: If the weights are of another scene, or there are none.
            BitstreamError: If those that the stream carries are damaged.
        """
        context = to_tensors(context)
        weights = self.loaded or carried_weights(context)
        check_fits(weights, context)
        filled = to_tensors(interpolator(weights.settings)(context).elements)
        graph = build_graph(context, weights.settings, filled)
        if graph.index.numel() == 0:
            return Concealed.filled(filled)
        repaired = repair(context, graph, weights.network)
        return Concealed.filled(_put(filled, graph, repaired))


def carried_weights(context: Partial) -> GnnWeights:
    """Reads the weights that the stream carries.

    Raises:
        InvalidValueError: If it carries none, or those of another scene.
        BitstreamError: If they are damaged.
    """
    if SECTION not in context.sections:
        raise InvalidValueError(
            "concealer 'gnn' needs weights, and this stream carries none: name a file (gnn:FILE), or put them into the "
            "stream with `splatwire calibrate gnn SCENE -o SCENE.swz`"
        )
    return read_section(context.sections[SECTION], context)


@torch.no_grad()
def repair(context: Partial, graph: RepairGraph, network: InpaintingNetwork) -> Anchors:
    """Runs the network on all queries of a graph, in chunks; never returns a value that is not finite.

    Args:
        context: What arrived.
        graph: Its graph, with at least one neighbour.
        network: The network.

    Returns:
        The queries.
    """
    used = graph.index.unique()
    device = used.device
    place = torch.full((context.scene.anchors.num_anchors,), -1, dtype=torch.int64, device=device)
    place[used] = torch.arange(len(used), device=device)
    encoded = [network.encode_sources(source_inputs(context, rows)) for rows in used.split(_SOURCE_CHUNK)]
    sources = tuple(torch.cat(layer) for layer in zip(*encoded, strict=True))
    pieces = []
    for rows in torch.arange(len(graph.queries), device=device).split(_CHUNK):
        part = graph.select(rows)
        raw = network(query_inputs(context, part), sources, place[part.index])
        fused = branches(raw, prior_rows(context[Prior], part.queries), part.interpolated, network.settings)
        pieces.append(fuse(fused, part.interpolated, network.settings))
    names = ("positions", "features", "scalings", "offsets", "mask")
    whole = Anchors(**{name: torch.cat([getattr(piece, name) for piece in pieces]) for name in names})
    return _finite(context, whole, graph.interpolated)


def _finite(context: Partial, anchors: Anchors, interpolated: Anchors) -> Anchors:
    """Takes the interpolation where a value is not finite, and keeps sizes plausible where they were predicted."""
    good = anchors.features.isfinite().all(dim=1) & anchors.scalings.isfinite().all(dim=1)
    good &= anchors.offsets.flatten(1).isfinite().all(dim=1)
    same = (anchors.scalings == interpolated.scalings).all(dim=1, keepdim=True)
    scalings = torch.where(
        same, anchors.scalings, plausible_scalings(context.scene.anchors, context.erasures, anchors.scalings)
    )
    return replace(
        anchors,
        features=torch.where(good[:, None], anchors.features, interpolated.features),
        scalings=torch.where(good[:, None], scalings, interpolated.scalings),
        offsets=torch.where(good[:, None, None], anchors.offsets, interpolated.offsets),
        mask=torch.where(good[:, None], anchors.mask, interpolated.mask),
    )


def _put(filled: Anchors, graph: RepairGraph, repaired: Anchors) -> Anchors:
    names = ("features", "scalings", "offsets", "mask")
    parts = {name: getattr(filled, name).clone() for name in names}
    for name in names:
        parts[name][graph.queries] = getattr(repaired, name)
    return replace(filled, **parts)
