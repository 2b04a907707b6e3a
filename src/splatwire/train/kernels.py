"""Which code does the heavy parts of an iteration: compiled for the CPU, or plain torch and gsplat for a GPU."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.render.backends import create_training_renderer
from splatwire.render.base import TrainingRenderer
from splatwire.render.differentiable import draw_cpu
from splatwire.train.adam import AdamUpdate, adam_update
from splatwire.train.grid import GridCorners, interpolate_signs
from splatwire.train.losses import Photo, photometric_loss, prepare_photo
from splatwire.train.plain import (
    adam_update_plain,
    interpolate_signs_plain,
    photometric_loss_plain,
    prepare_photo_plain,
)

REPORT_INTERVAL = 20
"""Iterations on a device between two copies of their numbers (loss, bits) to the host."""
Uniform = Callable[[torch.Size, torch.Generator, torch.device], Tensor]
"""Draws numbers in [0, 1) of a shape, with a generator on the CPU, for a device."""


def uniform_from_host(shape: torch.Size, generator: torch.Generator, device: torch.device) -> Float[Tensor, "*shape"]:
    """Draws on the CPU and moves: the same numbers on every device."""
    return torch.rand(shape, generator=generator).to(device)


def uniform_on_device(shape: torch.Size, generator: torch.Generator, device: torch.device) -> Float[Tensor, "*shape"]:
    """Draws a seed on the CPU and the numbers on the device: reproducible there, but not the numbers of a CPU.

    The noise of one iteration is tens of millions of numbers, for which a CPU takes longer than a GPU for all the rest.
    """
    return torch.rand(shape, generator=_seeded(generator, device), device=device)


def noise_from_host(
    rows: int, widths: Sequence[int], generator: torch.Generator, device: torch.device
) -> Float[Tensor, "rows width"]:
    """Draws columns in [0, 1) on the CPU, one group of columns after another, as `uniform_from_host` would."""
    return torch.cat([torch.rand(rows, width, generator=generator) for width in widths], dim=1).to(device)


def noise_on_device(
    rows: int, widths: Sequence[int], generator: torch.Generator, device: torch.device
) -> Float[Tensor, "rows width"]:
    """Draws all columns at once on the device, as `uniform_on_device`."""
    return uniform_on_device(torch.Size([rows, sum(widths)]), generator, device)


def sample_from_host(num: int, share: float, generator: torch.Generator, device: torch.device) -> Int64[Tensor, "M"]:
    """Draws rows on the CPU, each with probability `share`, and moves them; ascending."""
    return (torch.rand(num, generator=generator) <= share).nonzero()[:, 0].to(device)


def sample_on_device(num: int, share: float, generator: torch.Generator, device: torch.device) -> Int64[Tensor, "M"]:
    """Draws a fixed number of rows on the device, with replacement: nothing has to be counted, so nothing waits."""
    count = round(num * share)
    return torch.randint(num, (count,), generator=_seeded(generator, device), device=device)


def _seeded(generator: torch.Generator, device: torch.device) -> torch.Generator:
    return torch.Generator(device).manual_seed(int(torch.randint(1 << 62, (), generator=generator)))


@dataclass(frozen=True)
class Randomness:
    """Sources of an iteration's random numbers; each takes the run's generator, which is on the CPU, and a device.

    Attributes:
        uniform: Numbers in [0, 1) of a shape.
        noise: Rows of numbers in [0, 1), for groups of columns.
        sample: Rows among a number of rows, about a share of them.
    """

    uniform: Uniform
    noise: Callable[[int, Sequence[int], torch.Generator, torch.device], Tensor]
    sample: Callable[[int, float, torch.Generator, torch.device], Tensor]


HOST_RANDOMNESS = Randomness(uniform_from_host, noise_from_host, sample_from_host)
"""The same numbers on every device."""
DEVICE_RANDOMNESS = Randomness(uniform_on_device, noise_on_device, sample_on_device)
"""No copies between host and device."""


@dataclass(frozen=True)
class Kernels:
    """The parts of an iteration that are written twice.

    Attributes:
        draw: Draws the view.
        interpolate_signs: See `splatwire.train.grid.interpolate_signs`.
        prepare_photo: See `splatwire.train.losses.prepare_photo`.
        photometric_loss: See `splatwire.train.losses.photometric_loss`.
        adam_update: See `splatwire.train.adam.adam_update`.
        random: Sources of random numbers.
        asynchronous: True if the host only queues operations for a device: then few large operations without counting
            are fast, even if some rows are computed for nothing.
        report_interval: Iterations between two readings of the loss by the host.
    """

    draw: TrainingRenderer
    interpolate_signs: Callable[[Tensor, Tensor, GridCorners, Tensor], Tensor]
    prepare_photo: Callable[[Tensor, Tensor | None], Photo]
    photometric_loss: Callable[[Tensor, Photo, float], tuple[Tensor, Tensor]]
    adam_update: Callable[[Sequence[AdamUpdate]], None]
    random: Randomness
    asynchronous: bool
    report_interval: int


COMPILED = Kernels(
    draw_cpu, interpolate_signs, prepare_photo, photometric_loss, adam_update, HOST_RANDOMNESS, False, 1
)  # fmt: skip
"""For float32 tensors on the CPU, which is all that they take."""


def plain_kernels(draw: TrainingRenderer, random: Randomness = DEVICE_RANDOMNESS) -> Kernels:
    """Returns kernels in torch operations alone, for any device, around a renderer that works there."""
    return Kernels(
        draw, interpolate_signs_plain, prepare_photo_plain, photometric_loss_plain, adam_update_plain, random, True,
        REPORT_INTERVAL,
    )  # fmt: skip


def choose_kernels(device: torch.device) -> Kernels:
    """Returns the kernels for tensors on a device.

    Raises:
        BackendUnavailableError: There is no renderer for it, or it does not work here.
    """
    return COMPILED if device.type == "cpu" else plain_kernels(create_training_renderer(device))
