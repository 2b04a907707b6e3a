"""A network whose every head says something."""

import torch

from conceal.gaps import CONTEXT_DIM, LAYOUT
from splatwire.paper import GnnSettings
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes

SMALL = GnnSettings(neighbors=6, hidden=16)


def lively_network(settings: GnnSettings, seed: int) -> tuple[InpaintingNetwork, torch.Generator]:
    """A network that changes every attribute (the heads' last layers are not zero), and the generator for more."""
    network = InpaintingNetwork(InputSizes(LAYOUT, CONTEXT_DIM), settings, seed)
    rng = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for head in network.regressors:
            head[3].weight.copy_(torch.randn(head[3].weight.shape, generator=rng))
    return network.eval(), rng
