"""Adam, one fused pass over each parameter."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from splatwire.train.state import Moments

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15
"""Epsilon is so small that even the faintest gradient moves a parameter by its full learning rate (HAC++, training)."""
AdamUpdate = tuple[Tensor, Tensor, Moments, float]
"""A contiguous parameter of any shape, its gradient, Adam's memory of it, and its learning rate."""


@torch.no_grad()
def adam_update(updates: Sequence[AdamUpdate]) -> None:
    """Updates parameters and moments in place, compiled, on the CPU.

    Args:
        updates: One for each parameter.
    """
    from splatwire.train import _adam_kernels

    for parameter, gradient, moments, rate in updates:
        moments.steps += 1
        step_size, root = rate / (1 - BETA1**moments.steps), math.sqrt(1 - BETA2**moments.steps)
        tensors = (parameter, gradient.contiguous(), moments.first, moments.second)
        _adam_kernels.update(*(t.detach().view(-1).numpy() for t in tensors), step_size, root, BETA1, BETA2, EPSILON)
