"""The bipartite graph between lost and known anchors, and the inputs of its nodes (paper, Section 3.4)."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.conceal.base import Concealer
from splatwire.model import Partial, Prior
from splatwire.model.tensors import to_tensors
from splatwire.paper.cari import Cari
from splatwire.paper.gnn.settings import GnnSettings
from splatwire.paper.idw import Idw, fill_from_neighbors
from splatwire.paper.kriging import Kriging
from splatwire.scene import AnchorLayout, Anchors, Attribute


@dataclass(frozen=True, eq=False)
class RepairGraph:
    """Lost anchors, their known neighbours, and what interpolation makes of them.

    Attributes:
        queries: Anchors of which an attribute is missing.
        index: Their neighbours among the anchors of which everything is known.
        interpolated: The queries as the interpolation fills them: the teacher, and what is fallen back to.
        given: The queries as their inputs hold them.
    """

    queries: Int64[Tensor, "Q"]
    index: Int64[Tensor, "Q k"]
    interpolated: Anchors
    given: Anchors

    def select(self, rows: Int64[Tensor, "B"]) -> "RepairGraph":
        """Returns the graph of some of the queries."""
        return RepairGraph(
            self.queries[rows], self.index[rows], self.interpolated.select(rows), self.given.select(rows)
        )


def interpolator(settings: GnnSettings) -> Concealer:
    """The interpolation that the network is measured against and falls back to."""
    if settings.interpolation == "idw":
        return _graph_idw(settings)
    return Cari() if settings.interpolation == "cari" else Kriging()


def build_graph(context: Partial, settings: GnnSettings, filled: Anchors | None = None) -> RepairGraph:
    """Connects every lost anchor to its nearest known ones.

    Args:
        context: What arrived.
        settings: Number of neighbours, metric and interpolations.
        filled: All anchors as the interpolation fills them, if that is known already.

    Returns:
        The graph; `index` has no columns where nothing is known, fewer than k where less is known.
    """
    context = to_tensors(context)
    filled = to_tensors(interpolator(settings)(context).elements if filled is None else filled)
    known = context.erasures.known
    idw = _graph_idw(settings)
    pieces = list(idw.neighborhoods(context, known))
    queries = (~known).nonzero()[:, 0]
    index = torch.cat([piece[1] for piece in pieces]) if pieces else queries.new_zeros(len(queries), 0)
    given = filled
    if settings.query_input == "idw":
        given = context.filled
        for rows, near, weight in (piece for piece in pieces if len(piece[0])):
            fill_from_neighbors(context.scene.anchors, given, tuple(Attribute), rows, near, weight, idw.vote)
        given = context.elements.kept(context.erasures, given)
    return RepairGraph(queries, index, filled.select(queries), given.select(queries))


def _graph_idw(settings: GnnSettings) -> Idw:
    """Its neighbourhoods are the graph: Mahalanobis by the neighbour's covariance, round where that is unknown."""
    return Idw(neighbors=settings.neighbors, metric=settings.metric)


def attribute_columns(anchors: Anchors) -> Float[Tensor, "N D"]:
    """Features, scalings, offsets (zero where there is none) and mask side by side."""
    offsets = (anchors.offsets * anchors.mask[:, :, None]).flatten(1)
    return torch.cat([anchors.features, anchors.scalings, offsets, anchors.mask.to(offsets.dtype)], dim=1)


def source_inputs(context: Partial, rows: Int64[Tensor, "S"]) -> Float[Tensor, "S D"]:
    """Inputs of known anchors: `[x, hash feature, feature, scaling, offset, mask]`."""
    anchors = context.scene.anchors.select(rows)
    return torch.cat([context.places[rows], context[Prior].context[rows], attribute_columns(anchors)], dim=1)


def query_inputs(context: Partial, graph: RepairGraph) -> Float[Tensor, "Q D"]:
    """Inputs of lost anchors: `[x, hash feature, prior means, 0, interpolation]`, by default IDW's."""
    rows, prior = graph.queries, context[Prior]
    no_mask = prior.context.new_zeros(len(rows), context[AnchorLayout].num_offsets)
    means = [part.mean[rows] for part in (prior.feature, prior.scaling, prior.offset)]
    own = [context.places[rows], prior.context[rows], *means, no_mask]
    return torch.cat([*own, attribute_columns(graph.given)], dim=1)


def prior_rows(prior: Prior, rows: Int64[Tensor, "Q"]) -> Prior:
    """The prior of some anchors."""
    parts = {
        name: replace(part, mean=part.mean[rows], scale=part.scale[rows], step=part.step[rows])
        for name, part in (("feature", prior.feature), ("scaling", prior.scaling), ("offset", prior.offset))
    }
    return Prior(**parts, context=prior.context[rows])
