"""The network: EdgeConv layers, cross-attention to the prior, four heads (paper, Section 3.4)."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn import functional

from splatwire.paper.gnn.settings import GnnSettings
from splatwire.scene import AnchorLayout

_SLOPE = 0.2
"""Of the leaky rectifiers; the paper names no value, this is that of the EdgeConv paper."""


@dataclass(frozen=True)
class InputSizes:
    """Widths that follow from a scene.

    Attributes:
        layout: Sizes of an anchor.
        context_dim: Length of the hash-grid feature, H.
    """

    layout: AnchorLayout
    context_dim: int

    @property
    def attributes(self) -> int:
        """Features, scalings, offsets and mask of an anchor."""
        return self.layout.feature_dim + 6 + 4 * self.layout.num_offsets

    @property
    def source(self) -> int:
        """Inputs of a known anchor."""
        return 3 + self.context_dim + self.attributes

    @property
    def query(self) -> int:
        """Inputs of a lost anchor."""
        return self.source + self.attributes


@dataclass(frozen=True, eq=False)
class RawResiduals:
    """What the heads say: residuals in prior standard deviations, and mask logits.

    Attributes:
        feature: Of the feature channels.
        scaling: Of the scalings.
        offset: Of the offsets, offset-major.
        mask_logit: Positive where an offset exists.
    """

    feature: Float[Tensor, "Q F"]
    scaling: Float[Tensor, "Q 6"]
    offset: Float[Tensor, "Q K3"]
    mask_logit: Float[Tensor, "Q K"]


def strongest_edge(
    mine: Float[Tensor, "Q H"], theirs: Float[Tensor, "S H"], index: Int64[Tensor, "Q k"]
) -> Float[Tensor, "Q H"]:
    """EdgeConv `max_j phi(center h_i + edge (h_j - h_i) + bias)` with a leaky rectifier `phi`, in factored form.

    The two products are per node, `phi` is monotone and can follow the maximum: no value per edge is ever multiplied.

    Args:
        mine: `(center - edge) h_i + bias` of queries.
        theirs: `edge h_j` of known anchors.
        index: Neighbours of each query; without a neighbour the edges say nothing.
    """
    strongest = theirs[index].amax(dim=1) if index.shape[1] else 0.0
    return functional.leaky_relu(mine + strongest, _SLOPE)


class _EdgeLayer(nn.Module):
    """`h_i + Linear(EdgeConv(LN(h_i), {LN(h_j)}))`; known anchors have no incoming edges and stay as they are."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(hidden)
        self.center = nn.Linear(hidden, hidden)
        self.edge = nn.Linear(hidden, hidden, bias=False)
        self.output = nn.Linear(hidden, hidden)

    def project(self, others: Tensor) -> Tensor:
        """What known anchors say on their own: the same for all queries."""
        return self.edge(self.norm(others))

    def forward(self, own: Tensor, projected: Tensor, index: Tensor) -> Tensor:
        mine = functional.linear(self.norm(own), self.center.weight - self.edge.weight, self.center.bias)
        return own + self.output(strongest_edge(mine, projected, index))


class _CrossAttention(nn.Module):
    """The query looks at three tokens: its hash feature and its prior means of feature and scaling."""

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
    """Predicts residuals of lost anchors from the graph.

    The inputs are brought to mean 0 and spread 1 with constants that belong to the weights. The heads' last layers
    begin at zero, so an untrained network says the baseline with full confidence: in preset `paper` the prior's mean,
    not the interpolation.

    Args:
        sizes: Widths of the inputs.
        settings: Widths and options.
        seed: Seed of the initial weights.
    """

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
        """Embeds known anchors, once per EdgeConv layer; the result serves all their queries."""
        hidden = self.source((inputs - self.get_buffer("source_mean")) / self.get_buffer("source_spread"))
        return tuple(layer.project(hidden) for layer in self.edge_layers)

    @property
    def edge_layers(self) -> list[_EdgeLayer]:
        """The EdgeConv layers."""
        return [layer for layer in self.layers if isinstance(layer, _EdgeLayer)]

    def forward(
        self, inputs: Float[Tensor, "Q D"], sources: tuple[Float[Tensor, "S H"], ...], index: Int64[Tensor, "Q k"]
    ) -> RawResiduals:
        """Runs the network on some queries.

        Args:
            inputs: `query_inputs`.
            sources: Embedded known anchors (`encode_sources`).
            index: Neighbours, rows of `sources`.
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
