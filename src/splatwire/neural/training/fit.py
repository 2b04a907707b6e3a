"""Fits network parameters to fixed anchors, with Adam on random samples of the anchors."""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Int64
from torch import Tensor

from splatwire.errors import DivergedError
from splatwire.neural.training.config import RefineConfig
from splatwire.neural.training.schedule import half_cosine

_BETAS = (0.9, 0.99)
_FINAL_RATE_RATIO = 0.01
"""Final learning rate, as a share of the initial one."""


def fit_samples(
    groups: Sequence[tuple[list[Tensor], float]],
    num: int,
    config: RefineConfig,
    loss_of: Callable[[Int64[Tensor, "b"], torch.Generator], Tensor],
    progress: Callable[[float], None],
) -> None:
    """Minimises a loss over random samples of anchors by changing the parameters in place.

    Args:
        groups: Groups of parameters, each with its initial learning rate.
        num: Number of anchors to sample from.
        config: Settings of the refinement; number of Adam steps, batch size and seed are used.
        loss_of: Function that returns the loss of a sample, given the anchor indices of the sample and a random
            generator.
        progress: Called with the completed share, 0 to 1.

    Raises:
        DivergedError: If the loss is not finite.
    """
    generator = torch.Generator().manual_seed(config.seed)
    parameters = [{"params": tensors, "lr": rate, "base": rate} for tensors, rate in groups]
    optimiser = torch.optim.Adam(parameters, betas=_BETAS, eps=1e-15)
    for step in range(config.steps):
        for group in optimiser.param_groups:
            group["lr"] = group["base"] * max(half_cosine(step / config.steps), _FINAL_RATE_RATIO)
        loss = loss_of(torch.randperm(num, generator=generator)[: config.batch], generator)
        if not bool(torch.isfinite(loss.detach())):
            raise DivergedError(step)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        progress((step + 1) / config.steps)
