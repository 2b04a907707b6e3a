"""Which code does the heavy parts of an iteration: compiled for the CPU, or plain torch and gsplat for a GPU."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.render.backends import create_training_renderer
from splatwire.render.base import TrainingRenderer
from splatwire.render.cpu import draw_cpu
from splatwire.train.adam import adam_update
from splatwire.train.grid import GridCorners, interpolate_signs
from splatwire.train.losses import Photo, photometric_loss, prepare_photo
from splatwire.train.plain import (
    adam_update_plain,
    interpolate_signs_plain,
    photometric_loss_plain,
    prepare_photo_plain,
)
from splatwire.train.state import Moments

Uniform = Callable[[torch.Size, torch.Generator, torch.device], Tensor]
"""Draws numbers in [0, 1) of a shape, with a generator on the CPU, for a device."""


def uniform_from_host(shape: torch.Size, generator: torch.Generator, device: torch.device) -> Float[Tensor, "*shape"]:
    """Draws on the CPU and moves: the same numbers on every device."""
    return torch.rand(shape, generator=generator).to(device)


def uniform_on_device(shape: torch.Size, generator: torch.Generator, device: torch.device) -> Float[Tensor, "*shape"]:
    """Draws a seed on the CPU and the numbers on the device: reproducible there, but not the numbers of a CPU.

    The noise of one iteration is tens of millions of numbers, for which a CPU takes longer than a GPU for all the rest.
    """
    seed = int(torch.randint(1 << 62, (), generator=generator))
    return torch.rand(shape, generator=torch.Generator(device).manual_seed(seed), device=device)


@dataclass(frozen=True)
class Kernels:
    """The parts of an iteration that are written twice.

    Attributes:
        draw: Draws the view.
        interpolate_signs: See `splatwire.train.grid.interpolate_signs`.
        prepare_photo: See `splatwire.train.losses.prepare_photo`.
        photometric_loss: See `splatwire.train.losses.photometric_loss`.
        adam_update: See `splatwire.train.adam.adam_update`.
        uniform: Draws the noise that stands for rounding.
    """

    draw: TrainingRenderer
    interpolate_signs: Callable[[Tensor, Tensor, GridCorners, Tensor], Tensor]
    prepare_photo: Callable[[Tensor, Tensor | None], Photo]
    photometric_loss: Callable[[Tensor, Photo, float], tuple[Tensor, Tensor]]
    adam_update: Callable[[Tensor, Tensor, Moments, float], None]
    uniform: Uniform


COMPILED = Kernels(draw_cpu, interpolate_signs, prepare_photo, photometric_loss, adam_update, uniform_from_host)
"""For float32 tensors on the CPU, which is all that they take."""


def plain_kernels(draw: TrainingRenderer, uniform: Uniform = uniform_on_device) -> Kernels:
    """Returns kernels in torch operations alone, for any device, around a renderer that works there."""
    return Kernels(
        draw, interpolate_signs_plain, prepare_photo_plain, photometric_loss_plain, adam_update_plain, uniform
    )


def choose_kernels(device: torch.device) -> Kernels:
    """Returns the kernels for tensors on a device.

    Raises:
        BackendUnavailableError: There is no renderer for it, or it does not work here.
    """
    return COMPILED if device.type == "cpu" else plain_kernels(create_training_renderer(device))
