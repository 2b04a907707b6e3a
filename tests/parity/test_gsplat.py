"""Our renderers against gsplat's, where there is a GPU."""

import pytest
import torch

from splatwire.render import create_renderer
from splatwire.scene import Cameras, Gaussians


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_gsplat_draws_what_the_cpu_renderer_draws() -> None:
    pytest.importorskip("gsplat", reason="needs the gpu extra")
    generator = torch.Generator().manual_seed(0)
    means = torch.rand(2000, 3, generator=generator) * 2 - 1 + torch.tensor([0.0, 0.0, 3.0])
    quats = torch.nn.functional.normalize(torch.randn(2000, 4, generator=generator), dim=1)
    scales = 0.01 + 0.05 * torch.rand(2000, 3, generator=generator)
    opacities, colors = torch.rand(2000, generator=generator), torch.rand(2000, 3, generator=generator)
    gaussians = Gaussians(means, quats, scales, opacities, colors)
    K = torch.tensor([[[150.0, 0, 80], [0, 150.0, 60], [0, 0, 1]]])
    cameras = Cameras(torch.eye(4)[None], K, 160, 120, ("only",))
    background = torch.tensor([0.1, 0.2, 0.3])
    ours = create_renderer("cpu")(gaussians, cameras, background=background)
    theirs = create_renderer("gsplat")(gaussians, cameras, background=background)
    mse = (ours - theirs).square().mean()
    assert -10 * torch.log10(mse) > 50
