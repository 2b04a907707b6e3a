"""The Adam optimiser, compiled."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from splatwire.neural.training.state import Moments
from splatwire.ops import adam

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15
"""Constants of Adam as in HAC++. Epsilon is so small that a tiny gradient also causes a step of the learning rate."""
AdamUpdate = tuple[Tensor, Tensor, Moments, float]
"""A contiguous parameter of any shape, its gradient, its moments, and its learning rate."""


@torch.no_grad()
def adam_update(updates: Sequence[AdamUpdate]) -> None:
    """Updates parameters and moments in place, compiled, on the CPU.

    Args:
        updates: For each parameter: the parameter, its gradient, its moments and its learning rate.
    """
    for parameter, gradient, moments, rate in updates:
        moments.steps += 1
        step_size, root = rate / (1 - BETA1**moments.steps), math.sqrt(1 - BETA2**moments.steps)
        tensors = (parameter, gradient.contiguous(), moments.first, moments.second)
        adam.update(*(t.detach().view(-1).numpy() for t in tensors), step_size, root, BETA1, BETA2, EPSILON)
