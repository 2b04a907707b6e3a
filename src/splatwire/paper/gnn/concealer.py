"""The concealer `gnn`: estimates residuals of lost anchors with the trained inpainting network."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import torch

from splatwire.arguments import check_fields
from splatwire.concealment.base import Concealed
from splatwire.concealment.registry import register_concealer
from splatwire.errors import InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from splatwire.paper.gnn.fusion import branches, fuse
from splatwire.paper.gnn.graph import RepairGraph, build_graph, interpolator, prior_rows, query_inputs, source_inputs
from splatwire.paper.gnn.network import InpaintingNetwork
from splatwire.paper.gnn.section import SECTION, read_section
from splatwire.paper.gnn.weights import GnnWeights, check_fits, load_weights
from splatwire.types import Anchors, Prior, ReceivedScene
from splatwire.types.prior import plausible_scalings

_CHUNK = 768
"""Lost anchors (queries) per chunk; small enough that the data of their graph edges stays in the CPU cache."""
_SOURCE_CHUNK = 1 << 13


@register_concealer("gnn", needs=[Prior], option="weights", section=SECTION)
@dataclass(frozen=True)
class Gnn:
    """Concealer that estimates lost anchors with a graph neural network (GNN), calibrated on the scene.

    The network predicts residuals, which are added to the values that the hash grid predicts. Source: Section 3.4 of
    the paper (`docs/paper-map.md`).

    Attributes:
        weights: Path of a file written by `splatwire calibrate gnn`, or the weights themselves; None to use the weights
            in the stream.
        loaded: The weights, read from the file if `weights` is a path; None to use the weights in the stream.
    """

    # If no anchor was received completely, the network is not used, and the interpolation returns the prior's mean.
    # If fewer anchors were received completely than `GnnSettings.neighbors`, all of them are neighbours. Network
    # outputs that are not finite are replaced by interpolated values.

    weights: str | Path | GnnWeights | None = None
    loaded: GnnWeights | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_fields(self)
        known = self.weights is None or isinstance(self.weights, GnnWeights)
        object.__setattr__(self, "loaded", self.weights if known else load_weights(Path(str(self.weights))))

    @property
    def name(self) -> str:
        """Name in the registry of concealers: `gnn`."""
        return "gnn"

    def __call__(self, context: ReceivedScene) -> Concealed:
        """Returns the scene with the lost attributes estimated by the network.

        Raises:
            InvalidValueError: If the weights belong to another scene, or the stream has no weights.
            BitstreamError: If the weights in the stream are damaged.
        """
        context = to_tensors(context)
        weights = self.loaded or weights_in_stream(context)
        check_fits(weights, context)
        filled = to_tensors(interpolator(weights.settings)(context).elements)
        graph = build_graph(context, weights.settings, filled)
        if graph.index.numel() == 0:
            return Concealed.filled(filled)
        repaired = repair(context, graph, weights.network)
        return Concealed.filled(_with_repaired(filled, graph, repaired))


def weights_in_stream(context: ReceivedScene) -> GnnWeights:
    """Reads the network's weights from the section `gnn` of a stream's side information.

    Raises:
        InvalidValueError: If the stream has no section `gnn`, or the weights belong to another scene.
        BitstreamError: If the weights are damaged.
    """
    if SECTION not in context.sections:
        raise InvalidValueError(
            "concealer 'gnn' needs weights, and this stream carries none: name a file (gnn:FILE), or put them into the "
            "stream with `splatwire calibrate gnn SCENE -o SCENE.swz`"
        )
    return read_section(context.sections[SECTION], context)


@torch.no_grad()
def repair(context: ReceivedScene, graph: RepairGraph, network: InpaintingNetwork) -> Anchors:
    """Estimates the attributes of all lost anchors (queries) of a graph with the network.

    Args:
        context: The received scene.
        graph: Graph from lost to received anchors, with at least one neighbour per query.
        network: The inpainting network.

    Returns:
        The concealed anchors in the order of `graph.queries`.
    """
    # In chunks of queries; all values are finite.
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
    return _replace_invalid(context, whole, graph.interpolated)


def _replace_invalid(context: ReceivedScene, anchors: Anchors, interpolated: Anchors) -> Anchors:
    """Replaces predictions that are not finite by the interpolation, and raises scalings that are too small.

    Args:
        context: The received scene; its smallest received scaling is the minimum.
        anchors: Lost anchors as predicted.
        interpolated: The same anchors as interpolated.
    """
    # Anchors with a prediction that is NaN or infinite get the interpolated values. Predicted scalings may
    # be negative: the smallest received scaling is their minimum.
    good = anchors.features.isfinite().all(dim=1) & anchors.scalings.isfinite().all(dim=1)
    good &= anchors.offsets.flatten(1).isfinite().all(dim=1)
    same = (anchors.scalings == interpolated.scalings).all(dim=1, keepdim=True)
    scalings = torch.where(
        same, anchors.scalings, plausible_scalings(context.scene.anchors, context.loss_mask, anchors.scalings)
    )
    return replace(
        anchors,
        features=torch.where(good[:, None], anchors.features, interpolated.features),
        scalings=torch.where(good[:, None], scalings, interpolated.scalings),
        offsets=torch.where(good[:, None, None], anchors.offsets, interpolated.offsets),
        mask=torch.where(good[:, None], anchors.mask, interpolated.mask),
    )


def _with_repaired(filled: Anchors, graph: RepairGraph, repaired: Anchors) -> Anchors:
    names = ("features", "scalings", "offsets", "mask")
    parts = {name: getattr(filled, name).clone() for name in names}
    for name in names:
        parts[name][graph.queries] = getattr(repaired, name)
    return replace(filled, **parts)
