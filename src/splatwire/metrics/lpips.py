"""LPIPS v0.1 (Zhang et al. 2018) in numpy, with weights from files; nothing is downloaded.

There are two variants with different results: `lpips` scales images to [-1, 1] as in training; `lpips_unscaled` does
not, like the code of 3DGS, Scaffold-GS and HAC++, and like tables published with that code.
"""

import functools
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from splatwire.errors import DatasetError, UnknownNameError
from splatwire.files.tensors import read_tensors
from splatwire.metrics.lpips_files import find_lpips_files
from splatwire.metrics.masks import image_pair
from splatwire.ops.arrays import to_numpy

MAX_WEIGHT_BYTES = 1 << 30
"""Maximum size of a weight file, bytes; torchvision's VGG16 file has half of that size."""
Convolution: TypeAlias = tuple[int, int, int, int, int]
"""A convolution: key of its weights in `features.N`, number of outputs, kernel size, stride, padding. A rectifier
follows it."""


@dataclass(frozen=True)
class _Backbone:
    """Layers of the image network (VGG16 or AlexNet) whose features LPIPS compares.

    Attributes:
        pool: Kernel size of the max pooling (stride 2) before each stage; 0 without pooling.
        stages: Convolutions of each stage; LPIPS compares the outputs of the stages.
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
_SHIFT, _SCALE = np.array([-0.030, -0.088, -0.188], np.float32), np.array([0.458, 0.448, 0.450], np.float32)
_BLOCK = 1 << 21
"""Maximum number of matrix elements per block of a convolution, which limits memory."""


@dataclass(frozen=True, eq=False)
class Lpips:
    """The LPIPS metric with its network weights.

    Attributes:
        network: `vgg` or `alex`.
        convolutions: Weight and bias of each convolution, by its index in torchvision's network.
        linear: Non-negative weight of each channel, for each stage.
    """

    network: str
    convolutions: Mapping[int, tuple[np.ndarray, np.ndarray]]
    linear: tuple[np.ndarray, ...]

    def __call__(
        self, images: Float[Any, "C H W 3"], references: Float[Any, "C H W 3"], *, scaled: bool = True
    ) -> Float[np.ndarray, "C"]:
        """Computes the LPIPS distance between the picture and the reference picture of each of C views.

        The distance of equal pictures is 0.

        Args:
            images: Pictures of the C views, RGB in [0, 1], at least 64 pixels on each side.
            references: Reference pictures of the same views, RGB in [0, 1].
            scaled: True to scale images to [-1, 1], the range of the network's training. False to pass [0, 1], as 3DGS
                does.

        Raises:
            InvalidValueError: If the pictures have different sizes, or values far outside [0, 1].
        """
        pairs = zip(*image_pair(images, references), strict=True)  # one view at a time to bound memory
        each = [self.distance(*(self.features(x[None], scaled=scaled) for x in pair)) for pair in pairs]
        return np.concatenate(each)

    def features(
        self, images: Float[Any, "C H W 3"], *, scaled: bool = True
    ) -> tuple[Float[np.ndarray, "C D h w"], ...]:
        """Returns the features of C pictures from each stage of the network, normalised at every position.

        The method `distance` compares the features of two sets of pictures.

        Args:
            images: The C pictures, RGB in [0, 1].
            scaled: True to scale images to [-1, 1], the range of the network's training. False to pass [0, 1], as 3DGS
                does.
        """
        views = [self._features_of(to_numpy(image).astype(np.float32), scaled=scaled) for image in images]
        return tuple(np.stack(stage) for stage in zip(*views, strict=True))

    def _features_of(self, image: Float[np.ndarray, "H W 3"], *, scaled: bool) -> list[Float[np.ndarray, "D h w"]]:
        layout, outputs = _BACKBONES[self.network], []
        pixels = image * 2 - 1 if scaled else image
        x = np.ascontiguousarray(((pixels - _SHIFT) / _SCALE).transpose(2, 0, 1))
        for pool, stage in zip(layout.pool, layout.stages, strict=True):
            if pool:
                x = _pooled(x, pool)
            for key, _, _, stride, padding in stage:
                x = _convolved(x, *self.convolutions[key], stride, padding)
            outputs.append(x / (np.sqrt(np.einsum("dhw,dhw->hw", x, x)) + np.float32(1e-10)))
        return outputs

    def distance(self, first: tuple[np.ndarray, ...], second: tuple[np.ndarray, ...]) -> Float[np.ndarray, "C"]:
        """Returns the LPIPS distance of each of C pairs of pictures, from their features.

        Args:
            first: Result of the method `features` for the first picture of each pair.
            second: Result of the method `features` for the second picture of each pair.
        """
        total = np.zeros(len(first[0]), np.float32)
        for a, b, weight in zip(first, second, self.linear, strict=True):
            total += np.einsum("cdhw,d->chw", (a - b) ** 2, weight).mean(axis=(1, 2))
        return total


def _convolved(
    x: Float[np.ndarray, "D h w"],
    weight: Float[np.ndarray, "O D k k"],
    bias: Float[np.ndarray, "O"],
    stride: int,
    padding: int,
) -> Float[np.ndarray, "O H W"]:
    """Applies a convolution and a ReLU."""
    kernel = weight.shape[2]
    padded = np.pad(x, ((0, 0), (padding, padding), (padding, padding)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (kernel, kernel), (1, 2))[:, ::stride, ::stride]
    matrix, (rows, columns) = weight.reshape(len(weight), -1), windows.shape[1:3]
    out, step = np.empty((len(weight), rows, columns), np.float32), max(1, _BLOCK // (matrix.shape[1] * columns))
    for first in range(0, rows, step):
        part = windows[:, first : first + step].transpose(0, 3, 4, 1, 2).reshape(matrix.shape[1], -1)
        out[:, first : first + step] = (matrix @ part + bias[:, None]).reshape(len(weight), -1, columns)
    return np.maximum(out, 0, out=out)


def _pooled(x: Float[np.ndarray, "D h w"], kernel: int) -> Float[np.ndarray, "D H W"]:
    """Computes max pooling with stride 2."""
    rows, columns = ((size - kernel) // 2 + 1 for size in x.shape[1:])
    shifted = (
        x[:, i : i + 2 * rows - 1 : 2, j : j + 2 * columns - 1 : 2] for i in range(kernel) for j in range(kernel)
    )
    return functools.reduce(np.maximum, shifted)


def load_lpips(backbone: str | os.PathLike[str], linear: str | os.PathLike[str], network: str = "vgg") -> Lpips:
    """Loads the network and the weights of the LPIPS metric from files.

    Args:
        backbone: File with torchvision's ImageNet weights, keys `features.N.weight` and `features.N.bias` (others are
            ignored).
        linear: File with the LPIPS v0.1 linear layers, keys `linN.model.1.weight`.
        network: `vgg` (VGG16) or `alex` (AlexNet).

    Raises:
        DatasetError: If a file is missing or has other content.
        UnknownNameError: If the network does not exist.
    """
    layout = _layout(network)
    weights, mixing = (read_tensors(Path(path), DatasetError, MAX_WEIGHT_BYTES) for path in (backbone, linear))
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
    """Loads LPIPS from the weight files that environment variables name (`find_lpips_files`); None if no file is named.

    Raises:
        DatasetError: If a named file is missing or has other content.
        UnknownNameError: If the network does not exist.
    """
    files = find_lpips_files(network)
    return None if files is None else load_lpips(*files, network)


def _layout(network: str) -> _Backbone:
    if network not in _BACKBONES:
        raise UnknownNameError("LPIPS network", network, _BACKBONES)
    return _BACKBONES[network]


def _take(weights: Mapping[str, Any], key: str, shape: tuple[int, ...], path: str | os.PathLike[str]) -> np.ndarray:
    values = weights.get(key)
    if not isinstance(values, np.ndarray) or values.shape != shape:
        actual = values.shape if isinstance(values, np.ndarray) else "nothing"
        raise DatasetError(f"{os.fspath(path)}: '{key}' should have shape {shape}, found {actual}")
    return values.astype(np.float32)
