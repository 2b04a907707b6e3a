"""A test network: every head affects the result."""

import torch

from concealment.gaps import CONTEXT_DIM, LAYOUT
from splatwire.paper import GnnSettings
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes

SMALL = GnnSettings(neighbors=6, hidden=16)


def lively_network(settings: GnnSettings, seed: int) -> tuple[InpaintingNetwork, torch.Generator]:
    """A network that changes every attribute (the last layers of its heads are not zero), and its generator."""
    network = InpaintingNetwork(InputSizes(LAYOUT, CONTEXT_DIM), settings, seed)
    rng = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for head in network.regressors:
            head[3].weight.copy_(torch.randn(head[3].weight.shape, generator=rng))
    return network.eval(), rng
