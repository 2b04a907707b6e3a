"""Fitting to what stands still: steps of Adam over random samples, at rates that fall along half a cosine."""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Int64
from torch import Tensor

from splatwire.errors import DivergedError
from splatwire.train.config import RefineConfig
from splatwire.train.schedule import half_cosine

_BETAS = (0.9, 0.99)
_LEAST_RATE = 0.01
"""Learning rates fall along half a cosine to this share."""


def fit_samples(
    groups: Sequence[tuple[list[Tensor], float]],
    num: int,
    config: RefineConfig,
    loss_of: Callable[[Int64[Tensor, "b"], torch.Generator], Tensor],
    progress: Callable[[float], None],
) -> None:
    """Fits parameters in place.

    Args:
        groups: Parameters and the rate at which they begin to learn.
        num: Anchors to draw samples of.
        config: How long, over how many at a time, and the seed.
        loss_of: The loss of a sample, given its rows and what else draws numbers.
        progress: Called with the share that is done.

    Raises:
        DivergedError: If the loss stops being finite.
    """
    generator = torch.Generator().manual_seed(config.seed)
    parameters = [{"params": tensors, "lr": rate, "base": rate} for tensors, rate in groups]
    optimiser = torch.optim.Adam(parameters, betas=_BETAS, eps=1e-15)
    for step in range(config.steps):
        for group in optimiser.param_groups:
            group["lr"] = group["base"] * max(half_cosine(step / config.steps), _LEAST_RATE)
        loss = loss_of(torch.randperm(num, generator=generator)[: config.batch], generator)
        if not bool(torch.isfinite(loss.detach())):
            raise DivergedError(step)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        progress((step + 1) / config.steps)
