import numpy as np
import pytest
import torch

from splatwire.model import (
    AnchorScene,
    AttributePrior,
    ContextModel,
    GaussianHeads,
    HacppCoding,
    HashGrid,
    HashGridConfig,
    Linear,
    Mlp,
    ModelConfig,
    Partial,
    Prior,
    RenderHints,
)
from splatwire.model.voxels import voxel_positions
from splatwire.ops.arrays import to_arrays
from splatwire.scene import AnchorLayout, Anchors, Erasures

GRID = HashGridConfig(2, (6, 11, 20), (9, 33), 8, 9)
TINY = ModelConfig(AnchorLayout(5, 3, (2, 3)), GRID, (1.0, 0.001, 0.2))
VOXEL_SIZE = 0.013


@pytest.fixture
def tiny_scene() -> AnchorScene:
    """Seven anchors of an odd shape, every tensor different."""
    g = torch.Generator().manual_seed(7)

    def mlp(inputs: int, outputs: int, slope: float = 0.0) -> Mlp:
        return Mlp(
            Linear(torch.randn(4, inputs, generator=g), torch.randn(4, generator=g)),
            Linear(torch.randn(outputs, 4, generator=g), torch.randn(outputs, generator=g)),
            slope,
        )

    def signs(*shape: int) -> torch.Tensor:
        return (torch.randint(0, 2, shape, generator=g) * 2 - 1).to(torch.int8)

    mask = torch.rand(7, 3, generator=g) > 0.4
    anchors = Anchors(
        positions=torch.from_numpy(voxel_positions(torch.randint(-90, 200, (7, 3), generator=g), VOXEL_SIZE)),
        features=torch.randn(7, 5, generator=g),
        scalings=torch.rand(7, 6, generator=g),
        offsets=torch.randn(7, 3, 3, generator=g) * mask[:, :, None],
        mask=mask,
    )
    grid = HashGrid(
        signs(sum(GRID.rows(3)), 2), signs(3, sum(GRID.rows(2)), 2), torch.full((3,), -2.0), torch.full((3,), 3.5)
    )
    channel = (mlp(15, 6, 0.01), mlp(17, 9, 0.01))
    context = ContextModel(grid, mlp(GRID.context_dim, TINY.prior_dim), channel)
    heads = GaussianHeads(mlp(9, 3), mlp(9, 21), mlp(9, 9))
    return to_arrays(AnchorScene(anchors, heads, HacppCoding(context, VOXEL_SIZE, TINY)))


@pytest.fixture
def tiny_hints() -> RenderHints:
    return RenderHints(np.linspace(1, 2, 7, dtype=np.float32), np.arange(7) % 3 == 0)


@pytest.fixture
def tiny_partial(tiny_scene) -> Partial:
    g = torch.Generator().manual_seed(8)

    def prior(channels: int) -> AttributePrior:
        return AttributePrior(*(torch.rand(7, c, generator=g) for c in (channels, channels, 1)))

    full = Prior(prior(5), prior(6), prior(9), torch.randn(7, GRID.context_dim, generator=g))
    layout = tiny_scene.coding.config.layout
    return Partial(tiny_scene, Erasures.of_anchors(np.arange(7) % 2 == 0), {}, (to_arrays(full), layout))
