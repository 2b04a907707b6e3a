"""The inpainting network: EdgeConv layers, cross-attention to the prior, and four output heads.

Source: Section 3.4 of the paper (`docs/paper-map.md`).
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn import functional

from splatwire.paper.gnn.settings import GnnSettings
from splatwire.types import AnchorLayout

_SLOPE = 0.2
"""Slope of the leaky ReLUs for negative inputs, from the EdgeConv paper; the paper that we implement gives no value."""


@dataclass(frozen=True)
class InputSizes:
    """Numbers of inputs of the network, which depend on the scene.

    Attributes:
        layout: Numbers of channels of an anchor's attributes.
        context_dim: Length of the hash-grid feature, H.
    """

    layout: AnchorLayout
    context_dim: int

    @property
    def attributes(self) -> int:
        """Number of values of an anchor: all features, scalings, offsets and mask bits."""
        return self.layout.feature_dim + 6 + 4 * self.layout.num_offsets

    @property
    def source(self) -> int:
        """Number of network inputs for a completely received (known) anchor."""
        return 3 + self.context_dim + self.attributes

    @property
    def query(self) -> int:
        """Number of network inputs for a lost anchor."""
        return self.source + self.attributes


@dataclass(frozen=True, eq=False)
class RawResiduals:
    """Raw outputs of the network for lost anchors: residuals, in units of the prior's standard deviation, and masks.

    Attributes:
        feature: Residuals of the feature channels.
        scaling: Residuals of the scalings.
        offset: Residuals of the offsets: three components of the first offset, then three of the second, and so on.
        mask_logit: Logits of the offset masks; positive if an offset exists.
    """

    feature: Float[Tensor, "Q F"]
    scaling: Float[Tensor, "Q 6"]
    offset: Float[Tensor, "Q K3"]
    mask_logit: Float[Tensor, "Q K"]


def strongest_edge(
    query_terms: Float[Tensor, "Q H"], source_terms: Float[Tensor, "S H"], index: Int64[Tensor, "Q k"]
) -> Float[Tensor, "Q H"]:
    """Computes the graph convolution EdgeConv: maximum over the messages of each lost anchor's neighbours.

    The output of query i is the maximum over its neighbours j of `phi(center h_i + edge (h_j - h_i) + bias)`. Here h
    are the hidden vectors, `center` and `edge` are trained matrices, and `phi` is a leaky ReLU.

    Args:
        query_terms: `(center - edge) h_i + bias` of the queries.
        source_terms: `edge h_j` of the known anchors.
        index: Neighbours of each query, as rows of `source_terms`.
    """
    # The caller computes the matrix products once for each anchor. Without neighbours, their term is 0.
    strongest = source_terms[index].amax(dim=1) if index.shape[1] else 0.0
    return functional.leaky_relu(query_terms + strongest, _SLOPE)


class _EdgeLayer(nn.Module):
    """Layer of a graph neural network (EdgeConv) that updates the hidden vectors of lost anchors from known neighbours.

    The new vector of anchor i is `h_i + Linear(EdgeConv(LN(h_i), {LN(h_j)}))`, with its neighbours j and layer
    normalisation LN.
    """

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(hidden)
        self.center = nn.Linear(hidden, hidden)
        self.edge = nn.Linear(hidden, hidden, bias=False)
        self.output = nn.Linear(hidden, hidden)

    def project(self, others: Tensor) -> Tensor:
        """Returns the part of the EdgeConv messages that depends on the known anchors only.

        Args:
            others: Hidden vectors of the S known (completely received) anchors, (S, H).

        Returns:
            Contribution of each known anchor, (S, H).
        """
        # The result does not depend on the lost anchors (queries), so it is computed once for all of them.
        return self.edge(self.norm(others))

    def forward(self, own: Tensor, projected: Tensor, index: Tensor) -> Tensor:
        mine = functional.linear(self.norm(own), self.center.weight - self.edge.weight, self.center.bias)
        return own + self.output(strongest_edge(mine, projected, index))


class _CrossAttention(nn.Module):
    """Cross-attention of a lost anchor (query) to the anchor's hash-grid feature and prior."""

    # Attends to three vectors: the feature from the hash grid, and the means of feature and scaling that the prior
    # predicts. The result is added to the query's hidden vector.

    def __init__(self, hidden: int, heads: int, sizes: InputSizes) -> None:
        super().__init__()
        self.heads = heads
        widths = (sizes.context_dim, sizes.layout.feature_dim, 6)
        self.norm = nn.LayerNorm(hidden)
        self.query = nn.Linear(hidden, hidden)
        self.keys = nn.ModuleList(nn.Linear(width, hidden) for width in widths)
        self.values = nn.ModuleList(nn.Linear(width, hidden) for width in widths)
        self.output = nn.Linear(hidden, hidden)

    def forward(self, hidden: Tensor, tokens: tuple[Tensor, ...]) -> Tensor:
        shape = (len(hidden), self.heads, -1)
        query = self.query(self.norm(hidden)).view(shape)
        keys = [project(token).view(shape) for project, token in zip(self.keys, tokens, strict=True)]
        values = [project(token).view(shape) for project, token in zip(self.values, tokens, strict=True)]
        score = torch.stack([(query * key).sum(dim=2) for key in keys], dim=2) / math.sqrt(query.shape[2])
        share = score.softmax(dim=2)
        seen = sum(share[:, :, place, None] * value for place, value in enumerate(values))
        assert isinstance(seen, Tensor)
        return hidden + self.output(seen.flatten(1))


class InpaintingNetwork(nn.Module):
    """Predicts residuals of lost anchors (queries) from their neighbours in the graph.

    The residuals of an untrained network are 0. Its estimates are therefore equal to the baseline
    (`GnnSettings.baseline`): the interpolation, or the mean of the prior.

    Args:
        sizes: Numbers of inputs.
        settings: Settings of the network.
        seed: Seed of the initial weights.
    """

    # The inputs are standardised with constants that are part of the weights. The last layer of each head is
    # initialised with zero.

    def __init__(self, sizes: InputSizes, settings: GnnSettings, seed: int = 0) -> None:
        super().__init__()
        hidden = settings.hidden
        self.sizes, self.settings = sizes, settings
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.source = _encoder(sizes.source, hidden)
            self.query = _encoder(sizes.query, hidden)
            self.layers = nn.ModuleList(_EdgeLayer(hidden) for _ in range(settings.layers))
            self.attention = _CrossAttention(hidden, settings.heads, sizes) if settings.cross_attention else None
            outputs = (sizes.layout.feature_dim, 6, 3 * sizes.layout.num_offsets, sizes.layout.num_offsets)
            self.regressors = nn.ModuleList(_head(hidden, width) for width in outputs)
        for name, width in (("source", sizes.source), ("query", sizes.query)):
            self.register_buffer(f"{name}_mean", torch.zeros(width))
            self.register_buffer(f"{name}_spread", torch.ones(width))

    def encode_sources(self, inputs: Float[Tensor, "S D"]) -> tuple[Float[Tensor, "S H"], ...]:
        """Computes the contributions of the known anchors to each EdgeConv layer.

        The contributions are the same for all lost anchors, so they are computed once for many batches of lost anchors.

        Args:
            inputs: Network inputs of the S known anchors, from `source_inputs`.

        Returns:
            One contribution per layer.
        """
        hidden = self.source((inputs - self.get_buffer("source_mean")) / self.get_buffer("source_spread"))
        return tuple(layer.project(hidden) for layer in self.edge_layers)

    @property
    def edge_layers(self) -> list[_EdgeLayer]:
        """Layers of the graph convolution EdgeConv."""
        return [layer for layer in self.layers if isinstance(layer, _EdgeLayer)]

    def forward(
        self, inputs: Float[Tensor, "Q D"], sources: tuple[Float[Tensor, "S H"], ...], index: Int64[Tensor, "Q k"]
    ) -> RawResiduals:
        """Returns the predicted residuals and mask logits of lost anchors (queries).

        Args:
            inputs: Network inputs of the queries, from `query_inputs`.
            sources: Contributions of the known anchors, from `encode_sources`.
            index: Neighbours of each query, as rows of `sources`.
        """
        scaled = (inputs - self.get_buffer("query_mean")) / self.get_buffer("query_spread")
        hidden = self.query(scaled)
        for layer, projected in zip(self.edge_layers, sources, strict=True):
            hidden = layer(hidden, projected, index)
        if self.attention is not None:
            start, widths = 3, (self.sizes.context_dim, self.sizes.layout.feature_dim, 6)
            tokens = scaled[:, start : start + sum(widths)].split(widths, dim=1)
            hidden = self.attention(hidden, tokens)
        return RawResiduals(*(head(hidden) for head in self.regressors))


def _encoder(inputs: int, hidden: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.LeakyReLU(_SLOPE), nn.Linear(hidden, hidden))


def _head(hidden: int, outputs: int) -> nn.Sequential:
    last = nn.Linear(hidden, outputs)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.LayerNorm(hidden), nn.Linear(hidden, hidden), nn.LeakyReLU(_SLOPE), last)
