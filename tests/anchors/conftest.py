import numpy as np
import pytest

from random_numbers import Numbers
from splatwire.anchors.voxels import voxel_positions
from splatwire.types import (
    AnchorLayout,
    Anchors,
    AnchorScene,
    AttributePrior,
    GaussianHeads,
    HacppCoding,
    HacppConfig,
    HacppContextModel,
    HashGrid,
    HashGridConfig,
    Linear,
    LossMask,
    Mlp,
    Prior,
    ReceivedScene,
    RenderHints,
)

GRID = HashGridConfig(2, (6, 11, 20), (9, 33), 8, 9)
TINY = HacppConfig(AnchorLayout(5, 3, (2, 3)), GRID, (1.0, 0.001, 0.2))
VOXEL_SIZE = 0.013


@pytest.fixture
def tiny_scene() -> AnchorScene:
    """Seven anchors of an odd shape, every tensor different."""
    g = Numbers(7)

    def mlp(inputs: int, outputs: int, slope: float = 0.0) -> Mlp:
        return Mlp(
            Linear(g.randn(4, inputs), g.randn(4)),
            Linear(g.randn(outputs, 4), g.randn(outputs)),
            slope,
        )

    def signs(*shape: int) -> np.ndarray:
        return g.signs(shape).astype(np.int8)

    mask = g.rand(7, 3) > 0.4
    anchors = Anchors(
        positions=voxel_positions(g.randint(290, 7, 3) - 90, VOXEL_SIZE),
        features=g.randn(7, 5),
        scalings=g.rand(7, 6),
        offsets=g.randn(7, 3, 3) * mask[:, :, None],
        mask=mask,
    )
    low, high = np.full(3, -2, np.float32), np.full(3, 3.5, np.float32)
    grid = HashGrid(signs(sum(GRID.rows(3)), 2), signs(3, sum(GRID.rows(2)), 2), low, high)
    channel = (mlp(15, 6, 0.01), mlp(17, 9, 0.01))
    context = HacppContextModel(grid, mlp(GRID.context_dim, TINY.prior_dim), channel)
    heads = GaussianHeads(mlp(9, 3), mlp(9, 21), mlp(9, 9))
    return AnchorScene(anchors, heads, HacppCoding(context, VOXEL_SIZE, TINY))


@pytest.fixture
def tiny_hints() -> RenderHints:
    return RenderHints(np.linspace(1, 2, 7, dtype=np.float32), np.arange(7) % 3 == 0)


@pytest.fixture
def tiny_partial(tiny_scene) -> ReceivedScene:
    g = Numbers(8)

    def prior(channels: int) -> AttributePrior:
        return AttributePrior(*(g.rand(7, c) for c in (channels, channels, 1)))

    full = Prior(prior(5), prior(6), prior(9), g.randn(7, GRID.context_dim))
    layout = tiny_scene.coding.config.layout
    return ReceivedScene(tiny_scene, LossMask.of_elements(np.arange(7) % 2 == 0), {}, (full, layout))
