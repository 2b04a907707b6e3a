"""LPIPS v0.1 (Zhang et al. 2018) in plain torch, with weights from files; nothing is ever downloaded."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.errors import DatasetError, UnknownNameError
from splatwire.files.tensors import check_tensor_file
from splatwire.metrics.lpips_files import find_lpips_files
from splatwire.ops.arrays import to_numpy

MAX_WEIGHT_BYTES = 1 << 30
"""torchvision's VGG16 has half of this."""
Convolution: TypeAlias = tuple[int, int, int, int, int]
"""Key in `features.N`, outputs, kernel, stride, padding; a rectifier follows each."""


@dataclass(frozen=True)
class _Backbone:
    """A stack of convolutions in stages; what leaves a stage is compared, then pooled into the next.

    Attributes:
        pool: Kernel of the max pooling (stride 2) before a stage, per stage; 0 for none.
        stages: The convolutions of each stage.
    """

    pool: tuple[int, ...]
    stages: tuple[tuple[Convolution, ...], ...]


def _vgg_stage(channels: int, *keys: int) -> tuple[Convolution, ...]:
    return tuple((key, channels, 3, 1, 1) for key in keys)


_BACKBONES = {
    "vgg": _Backbone(
        (0, 2, 2, 2, 2),
        (
            _vgg_stage(64, 0, 2),
            _vgg_stage(128, 5, 7),
            _vgg_stage(256, 10, 12, 14),
            _vgg_stage(512, 17, 19, 21),
            _vgg_stage(512, 24, 26, 28),
        ),
    ),
    "alex": _Backbone(
        (0, 3, 3, 0, 0),
        (((0, 64, 11, 4, 2),), ((3, 192, 5, 1, 2),), ((6, 384, 3, 1, 1),), ((8, 256, 3, 1, 1),), ((10, 256, 3, 1, 1),)),
    ),
}
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


@dataclass(frozen=True, eq=False)
class Lpips:
    """The metric with its weights.

    Attributes:
        network: `vgg` or `alex`.
        convolutions: Weight and bias by key.
        linear: Non-negative weight of each channel, per stage.
    """

    network: str
    convolutions: Mapping[int, tuple[Tensor, Tensor]]
    linear: tuple[Tensor, ...]

    @torch.no_grad()
    def __call__(self, images: Float[Any, "C H W 3"], references: Float[Any, "C H W 3"]) -> Float[np.ndarray, "C"]:
        """Computes the distance of each view to its reference; 0 where they are equal.

        Args:
            images: RGB in [0, 1], at least 64 pixels on each side.
            references: RGB in [0, 1].
        """
        pairs = zip(images, references, strict=True)  # one view at a time bounds the memory
        each = [self.distance(self.features(a[None]), self.features(b[None])) for a, b in pairs]
        return np.concatenate([to_numpy(distance) for distance in each])

    @torch.no_grad()
    def features(self, images: Float[Any, "C H W 3"]) -> tuple[Tensor, ...]:
        """Returns the unit-length features of each stage, so that one reference can serve many comparisons."""
        x = torch.from_numpy(to_numpy(images)).permute(0, 3, 1, 2) * 2 - 1
        x = (x - x.new_tensor(_SHIFT).view(1, 3, 1, 1)) / x.new_tensor(_SCALE).view(1, 3, 1, 1)
        layout, outputs = _BACKBONES[self.network], []
        for pool, stage in zip(layout.pool, layout.stages, strict=True):
            if pool:
                x = torch.nn.functional.max_pool2d(x, pool, 2)
            for key, _, _, stride, padding in stage:
                weight, bias = self.convolutions[key]
                x = torch.relu(torch.nn.functional.conv2d(x, weight.to(x), bias.to(x), stride, padding))
            outputs.append(x / (torch.linalg.vector_norm(x, dim=1, keepdim=True) + 1e-10))
        return tuple(outputs)

    @torch.no_grad()
    def distance(self, first: tuple[Tensor, ...], second: tuple[Tensor, ...]) -> Float[Tensor, "C"]:
        """Computes the distance between two results of `features`."""
        total = first[0].new_zeros(first[0].shape[0])
        for a, b, weight in zip(first, second, self.linear, strict=True):
            total = total + torch.einsum("cdhw,d->chw", (a - b).square(), weight.to(a)).mean(dim=(1, 2))
        return total


def load_lpips(backbone: str | os.PathLike[str], linear: str | os.PathLike[str], network: str = "vgg") -> Lpips:
    """Loads LPIPS weights.

    Args:
        backbone: torchvision's ImageNet weights, keys `features.N.weight` and `features.N.bias` (others are ignored).
        linear: LPIPS v0.1 linear layers, keys `linN.model.1.weight`.
        network: `vgg` (VGG16) or `alex` (AlexNet).

    Raises:
        DatasetError: A file is missing or holds something else.
        UnknownNameError: No such network.
    """
    layout = _layout(network)
    weights, mixing = _load(Path(backbone)), _load(Path(linear))
    convolutions, channels, last = {}, 3, []
    for stage in layout.stages:
        for key, outputs, kernel, _, _ in stage:
            weight = _take(weights, f"features.{key}.weight", (outputs, channels, kernel, kernel), backbone)
            convolutions[key] = (weight, _take(weights, f"features.{key}.bias", (outputs,), backbone))
            channels = outputs
        last.append(channels)
    rows = [_take(mixing, f"lin{i}.model.1.weight", (1, c, 1, 1), linear).flatten() for i, c in enumerate(last)]
    return Lpips(network, convolutions, tuple(rows))


def find_lpips(network: str = "vgg") -> Lpips | None:
    """Loads LPIPS from where the environment says, or returns None: a report then says that the weights are absent.

    The environment names them as `splatwire.metrics.lpips_files.find_lpips_files` says.

    Raises:
        DatasetError: The environment names a file that is missing or holds something else.
        UnknownNameError: No such network.
    """
    files = find_lpips_files(network)
    return None if files is None else load_lpips(*files, network)


def _layout(network: str) -> _Backbone:
    if network not in _BACKBONES:
        raise UnknownNameError("LPIPS network", network, _BACKBONES)
    return _BACKBONES[network]


def _load(path: Path) -> Mapping[str, object]:
    check_tensor_file(path, DatasetError, MAX_WEIGHT_BYTES)
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch's loader raises many kinds; each of them means the same here
        raise DatasetError(f"{path} is not a readable file of LPIPS weights: {error}") from error
    if not isinstance(content, Mapping):
        raise DatasetError(f"{path} holds a {type(content).__name__}, not tensors by name")
    return content


def _take(weights: Mapping[str, object], key: str, shape: tuple[int, ...], path: str | os.PathLike[str]) -> Tensor:
    tensor = weights.get(key)
    if not isinstance(tensor, Tensor) or tuple(tensor.shape) != shape:
        found = tuple(tensor.shape) if isinstance(tensor, Tensor) else "nothing"
        raise DatasetError(f"{os.fspath(path)}: '{key}' should have shape {shape}, found {found}")
    return tensor.to(torch.float32)
