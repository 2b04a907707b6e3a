import pytest
import torch

from splatwire.neural.training.adam import adam_update
from splatwire.neural.training.plain import adam_update_plain
from splatwire.neural.training.state import Moments


@pytest.mark.parametrize("magnitude", [1.0, 1e-12])
def test_adam_equals_torch(magnitude: float) -> None:
    rng = torch.Generator().manual_seed(0)
    start = torch.randn(40_000, generator=rng)
    own, reference, theirs = start.clone(), start.clone(), torch.nn.Parameter(start.clone())
    optimizer = torch.optim.Adam([theirs], lr=0.01, eps=1e-15)
    memory = [Moments(torch.zeros_like(start), torch.zeros_like(start)) for _ in range(2)]
    for _ in range(5):
        gradient = torch.randn(start.shape, generator=rng) * magnitude
        adam_update([(own, gradient, memory[0], 0.01)])
        adam_update_plain([(reference, gradient, memory[1], 0.01)])
        theirs.grad = gradient
        optimizer.step()
    torch.testing.assert_close(own, theirs.detach(), atol=2e-6, rtol=1e-5)
    torch.testing.assert_close(reference, theirs.detach(), atol=2e-6, rtol=1e-5)
    assert memory[0].steps == 5
    assert (own - start).abs().mean() > 0.01  # even a faint gradient moves a parameter by about its rate
