"""Adam, one fused pass over each parameter."""

import math

import torch
from torch import Tensor

from splatwire.train.state import Moments

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15
"""Epsilon is so small that even the faintest gradient moves a parameter by its full learning rate (HAC++, training)."""


@torch.no_grad()
def adam_update(parameter: Tensor, gradient: Tensor, moments: Moments, rate: float) -> None:
    """Updates `parameter` and `moments` in place, compiled, on the CPU.

    Args:
        parameter: Any shape, contiguous.
        gradient: Same shape.
        moments: Adam's memory of it.
        rate: Learning rate.
    """
    from splatwire.train import _adam_kernels

    step_size, root = count_update(moments, rate)
    tensors = (parameter, gradient.contiguous(), moments.first, moments.second)
    _adam_kernels.update(*(t.detach().view(-1).numpy() for t in tensors), step_size, root, BETA1, BETA2, EPSILON)


def count_update(moments: Moments, rate: float) -> tuple[float, float]:
    """Counts an update; returns the bias-corrected step and the root of the second moment's correction."""
    moments.steps += 1
    return rate / (1 - BETA1**moments.steps), math.sqrt(1 - BETA2**moments.steps)
