"""Implementations of expensive training operations: compiled for the CPU, or plain torch and gsplat for a GPU."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.neural.render.differentiable import draw_cpu
from splatwire.neural.render.renderers import create_training_renderer
from splatwire.neural.training.adam import AdamUpdate, adam_update
from splatwire.neural.training.grid import GridCorners, interpolate_signs
from splatwire.neural.training.photometric_loss import Photo, photometric_loss, prepare_photo
from splatwire.neural.training.plain import (
    adam_update_plain,
    interpolate_signs_plain,
    photometric_loss_plain,
    prepare_photo_plain,
)
from splatwire.render.base import TrainingRenderer

REPORT_INTERVAL = 20
"""Number of iterations between two copies of results (loss, bits) from a GPU to the host."""
Uniform = Callable[[torch.Size, torch.Generator, torch.device], Tensor]
"""Function that draws uniform random numbers in [0, 1), given shape, CPU generator and target device."""


def uniform_from_host(shape: torch.Size, generator: torch.Generator, device: torch.device) -> Float[Tensor, "*shape"]:
    """Draws uniform random numbers in [0, 1) on the CPU and copies them to a device."""
    return torch.rand(shape, generator=generator).to(device)


def uniform_on_device(shape: torch.Size, generator: torch.Generator, device: torch.device) -> Float[Tensor, "*shape"]:
    """Draws uniform random numbers in [0, 1) on a device; reproducible, but different on each kind of device."""
    # The seed is drawn on the CPU. An iteration needs tens of millions of random numbers; drawing them on the CPU
    # takes longer than the rest of the iteration on a GPU.
    return torch.rand(shape, generator=_seeded(generator, device), device=device)


def noise_from_host(
    rows: int, widths: Sequence[int], generator: torch.Generator, device: torch.device
) -> Float[Tensor, "rows width"]:
    """Draws a matrix of uniform random numbers in [0, 1) on the CPU and copies it to a device.

    Args:
        rows: Number of rows.
        widths: Number of columns in each group of columns. The groups are drawn one after another, so that their widths
            affect the order of the random numbers.
        generator: Random generator, on the CPU.
        device: Device of the result.
    """
    return torch.cat([torch.rand(rows, width, generator=generator) for width in widths], dim=1).to(device)


def noise_on_device(
    rows: int, widths: Sequence[int], generator: torch.Generator, device: torch.device
) -> Float[Tensor, "rows width"]:
    """Draws a matrix of uniform random numbers in [0, 1) on a device.

    Args:
        rows: Number of rows.
        widths: Number of columns in each group of columns, as in `noise_from_host`; only their sum matters here.
        generator: Random generator, on the CPU, that gives the seed.
        device: Device of the result.
    """
    return uniform_on_device(torch.Size([rows, sum(widths)]), generator, device)


def sample_from_host(num: int, share: float, generator: torch.Generator, device: torch.device) -> Int64[Tensor, "M"]:
    """Draws a random subset of the indices below `num` on the CPU, each index with probability `share`.

    The result is ascending, on the given device.
    """
    return (torch.rand(num, generator=generator) <= share).nonzero()[:, 0].to(device)


def sample_on_device(num: int, share: float, generator: torch.Generator, device: torch.device) -> Int64[Tensor, "M"]:
    """Draws `num * share` random indices below `num` on a device, with replacement."""
    # The number of indices is fixed, which avoids a synchronisation with the device.
    count = round(num * share)
    return torch.randint(num, (count,), generator=_seeded(generator, device), device=device)


def _seeded(generator: torch.Generator, device: torch.device) -> torch.Generator:
    return torch.Generator(device).manual_seed(int(torch.randint(1 << 62, (), generator=generator)))


@dataclass(frozen=True)
class Randomness:
    """Random number generators of the training, which draw either on the CPU or on the training device.

    Attributes:
        uniform: Draws uniform random numbers in [0, 1): a tensor of a given shape.
        noise: Draws a matrix of uniform random numbers in [0, 1). The first argument is the number of rows. The second
            is the number of columns in each group of columns.
        sample: Returns the indices of randomly chosen anchors, int64 (M). The arguments are the number of anchors, the
            share to choose (0 to 1), a generator and a device. See `sample_from_host` and `sample_on_device`.
    """

    uniform: Uniform
    noise: Callable[[int, Sequence[int], torch.Generator, torch.device], Tensor]
    sample: Callable[[int, float, torch.Generator, torch.device], Tensor]


HOST_RANDOMNESS = Randomness(uniform_from_host, noise_from_host, sample_from_host)
"""Draws random numbers on the CPU: equal numbers on every device."""
DEVICE_RANDOMNESS = Randomness(uniform_on_device, noise_on_device, sample_on_device)
"""Draws random numbers on the device, without copies of large arrays from the host."""


@dataclass(frozen=True)
class Kernels:
    """Expensive operations of a training iteration, implemented for one kind of device.

    Attributes:
        draw: Renders a view.
        interpolate_signs: Interpolates the binary hash grid (`splatwire.neural.training.grid.interpolate_signs`).
        prepare_photo: Precomputes the terms of the loss that depend only on the photo (module `photometric_loss`).
        photometric_loss: Compares a rendered picture with a photo (`neural.training.photometric_loss`).
        adam_update: Updates parameters with Adam (`splatwire.neural.training.adam.adam_update`).
        random: Functions that draw random numbers.
        asynchronous: True if the CPU only queues the operations, for a GPU.
        report_interval: Number of iterations between two transfers of the loss from the device to the CPU.
    """

    # On an asynchronous device few large operations are faster, even if they compute unused values. Reading the
    # loss waits for the device.

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
"""Compiled implementations for float32 tensors on the CPU."""


def plain_kernels(draw: TrainingRenderer, random: Randomness = DEVICE_RANDOMNESS) -> Kernels:
    """Returns the expensive training operations in plain torch, for any device.

    Args:
        draw: Renderer for tensors on the training device.
        random: Functions that draw random numbers.
    """
    return Kernels(
        draw, interpolate_signs_plain, prepare_photo_plain, photometric_loss_plain, adam_update_plain, random, True,
        REPORT_INTERVAL,
    )  # fmt: skip


def choose_kernels(device: torch.device) -> Kernels:
    """Returns the fastest implementations of the expensive operations for tensors on a device.

    Raises:
        BackendUnavailableError: If no renderer supports the device, or the renderer is not usable.
    """
    return COMPILED if device.type == "cpu" else plain_kernels(create_training_renderer(device))
