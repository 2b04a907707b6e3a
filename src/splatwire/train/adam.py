"""Adam, one fused pass over each parameter."""

import math

import torch
from torch import Tensor

from splatwire.train.state import Moments

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15
"""Epsilon is so small that even the faintest gradient moves a parameter by its full learning rate (HACPP_SPEC 6)."""


@torch.no_grad()
def adam_update(parameter: Tensor, gradient: Tensor, moments: Moments, rate: float) -> None:
    """Updates `parameter` and `moments` in place, compiled, on the CPU.

    Args:
        parameter: Any shape, contiguous.
        gradient: Same shape.
        moments: Adam's memory of it.
        rate: Learning rate.
    """
    moments.steps += 1
    step_size = rate / (1 - BETA1**moments.steps)
    root = math.sqrt(1 - BETA2**moments.steps)
    if parameter.device.type == "cpu":
        from splatwire.train import _adam_kernels

        tensors = (parameter, gradient.contiguous(), moments.first, moments.second)
        _adam_kernels.update(*(t.detach().view(-1).numpy() for t in tensors), step_size, root, BETA1, BETA2, EPSILON)
    else:
        adam_update_reference(parameter, gradient, moments, step_size, root)


@torch.no_grad()
def adam_update_reference(parameter: Tensor, gradient: Tensor, moments: Moments, step_size: float, root: float) -> None:
    """The same in plain torch, given the bias-corrected step and the root of the second correction."""
    moments.first.lerp_(gradient, 1 - BETA1)
    moments.second.mul_(BETA2).addcmul_(gradient, gradient, value=1 - BETA2)
    denominator = (moments.second.sqrt() / root).add_(EPSILON)
    parameter.addcdiv_(moments.first, denominator, value=-step_size)
