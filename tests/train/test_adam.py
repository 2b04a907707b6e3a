import math

import pytest
import torch

from splatwire.train.adam import BETA1, BETA2, adam_update, adam_update_reference
from splatwire.train.state import Moments


@pytest.mark.parametrize("magnitude", [1.0, 1e-12])
def test_agrees_with_torch(magnitude: float) -> None:
    rng = torch.Generator().manual_seed(0)
    start = torch.randn(40_000, generator=rng)
    own, reference, theirs = start.clone(), start.clone(), torch.nn.Parameter(start.clone())
    optimizer = torch.optim.Adam([theirs], lr=0.01, eps=1e-15)
    memory = [Moments(torch.zeros_like(start), torch.zeros_like(start)) for _ in range(2)]
    for step in range(1, 6):
        gradient = torch.randn(start.shape, generator=rng) * magnitude
        adam_update(own, gradient, memory[0], 0.01)
        sizes = 0.01 / (1 - BETA1**step), math.sqrt(1 - BETA2**step)
        adam_update_reference(reference, gradient, memory[1], *sizes)
        theirs.grad = gradient
        optimizer.step()
    torch.testing.assert_close(own, theirs.detach(), atol=2e-6, rtol=1e-5)
    torch.testing.assert_close(reference, theirs.detach(), atol=2e-6, rtol=1e-5)
    assert memory[0].steps == 5
    assert (own - start).abs().mean() > 0.01  # however faint, a gradient moves a parameter by about its rate
