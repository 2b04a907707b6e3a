"""The bipartite graph between lost and known anchors, and the inputs of its nodes.

Source: Section 3.4 of the paper (`docs/paper-map.md`).
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.concealment.base import Concealer
from splatwire.neural.model.tensors import to_tensors
from splatwire.paper.cari import Cari
from splatwire.paper.gnn.settings import GnnSettings
from splatwire.paper.idw import Idw, fill_from_neighbors
from splatwire.paper.kriging import Kriging
from splatwire.types import AnchorLayout, Anchors, Attribute, Prior, ReceivedScene


@dataclass(frozen=True, eq=False)
class RepairGraph:
    """Graph on which the network repairs a scene: each incomplete anchor (query) is connected to complete anchors.

    An anchor is incomplete if at least one of its attributes was lost. The missing attributes of queries are first
    estimated by simple methods; the network corrects these estimates.

    Attributes:
        queries: Indices in the scene of the incomplete anchors.
        index: For each query, indices in the scene of the k nearest complete anchors.
        interpolated: The queries with missing attributes estimated by the method `GnnSettings.interpolation`.
        given: The queries with missing attributes estimated by the method `GnnSettings.query_input`. These estimates
            are inputs of the network.
    """

    queries: Int64[Tensor, "Q"]
    index: Int64[Tensor, "Q k"]
    interpolated: Anchors
    given: Anchors

    def select(self, rows: Int64[Tensor, "B"]) -> "RepairGraph":
        """Returns the part of the graph for a subset of the lost anchors, given as indices into `queries`."""
        return RepairGraph(
            self.queries[rows], self.index[rows], self.interpolated.select(rows), self.given.select(rows)
        )


def interpolator(settings: GnnSettings) -> Concealer:
    """Returns the concealer that the settings choose for interpolation."""
    if settings.interpolation == "idw":
        return _graph_idw(settings)
    return Cari() if settings.interpolation == "cari" else Kriging()


def build_graph(context: ReceivedScene, settings: GnnSettings, filled: Anchors | None = None) -> RepairGraph:
    """Connects every lost anchor to its k nearest completely received (known) anchors, as input of the network.

    Args:
        context: The received scene.
        settings: Settings of the network.
        filled: All anchors, with missing attributes filled by the interpolation; None to compute the interpolation.

    Returns:
        The graph, with fewer than k neighbours if fewer anchors are known.
    """
    context = to_tensors(context)
    filled = to_tensors(interpolator(settings)(context).elements if filled is None else filled)
    fully_received = context.loss_mask.fully_received
    idw = _graph_idw(settings)
    pieces = list(idw.neighborhoods(context, fully_received))
    queries = (~fully_received).nonzero()[:, 0]
    index = torch.cat([piece[1] for piece in pieces]) if pieces else queries.new_zeros(len(queries), 0)
    given = filled
    if settings.query_input == "idw":
        given = context.filled
        for rows, near, weight in (piece for piece in pieces if len(piece[0])):
            fill_from_neighbors(context.scene.anchors, given, tuple(Attribute), rows, near, weight, idw.vote)
        given = context.elements.with_estimates(context.loss_mask, given)
    return RepairGraph(queries, index, filled.select(queries), given.select(queries))


def _graph_idw(settings: GnnSettings) -> Idw:
    """Returns the concealer `idw` (inverse distance weighting) over the neighbours in the graph."""
    return Idw(neighbors=settings.neighbors, metric=settings.metric)


def attribute_columns(anchors: Anchors) -> Float[Tensor, "N D"]:
    """Returns all attributes of each anchor in one row: feature, scaling, offsets (zero if masked out) and mask."""
    offsets = (anchors.offsets * anchors.mask[:, :, None]).flatten(1)
    return torch.cat([anchors.features, anchors.scalings, offsets, anchors.mask.to(offsets.dtype)], dim=1)


def source_inputs(context: ReceivedScene, rows: Int64[Tensor, "S"]) -> Float[Tensor, "S D"]:
    """Returns the network's inputs for some completely received (known) anchors, one row per anchor.

    A row has the position, the feature from the hash grid, and the attributes: feature, scalings, offsets and mask.

    Args:
        context: The received scene.
        rows: Indices in the scene of the S known anchors.
    """
    anchors = context.scene.anchors.select(rows)
    return torch.cat(
        [context.positions[rows], context[Prior].context_features[rows], attribute_columns(anchors)], dim=1
    )


def query_inputs(context: ReceivedScene, graph: RepairGraph) -> Float[Tensor, "Q D"]:
    """Builds the inputs of the network for the lost anchors (queries), one row each.

    A row consists of the position, the feature from the hash grid, the means of all attributes predicted by the prior,
    and the attributes with lost values filled.
    """
    # The prior does not predict offset masks; zeros take the place of their means.
    rows, prior = graph.queries, context[Prior]
    no_mask = prior.context_features.new_zeros(len(rows), context[AnchorLayout].num_offsets)
    means = [part.mean[rows] for part in (prior.feature, prior.scaling, prior.offset)]
    own = [context.positions[rows], prior.context_features[rows], *means, no_mask]
    return torch.cat([*own, attribute_columns(graph.given)], dim=1)


def prior_rows(prior: Prior, rows: Int64[Tensor, "Q"]) -> Prior:
    """Returns the prior of the anchors with the given indices."""
    parts = {
        name: replace(part, mean=part.mean[rows], scale=part.scale[rows], step=part.step[rows])
        for name, part in (("feature", prior.feature), ("scaling", prior.scaling), ("offset", prior.offset))
    }
    return Prior(**parts, context_features=prior.context_features[rows])
