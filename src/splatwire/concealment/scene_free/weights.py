"""Network weight files of the concealer `scene_free` (safetensors), for anchors and for explicit Gaussians."""

from functools import cache
from importlib import resources
from pathlib import Path
from typing import TypeVar

import numpy as np

from splatwire.anchors.tensor_file import read_tensors, write_tensors
from splatwire.concealment.scene_free.elements import GaussianNetwork
from splatwire.concealment.scene_free.network import AnchorNetwork, Perceptron
from splatwire.errors import BitstreamError
from splatwire.types.networks import Linear

VERSION = 1
_FORMATS: dict[type[Perceptron], str] = {
    AnchorNetwork: "splatwire-scene-free", GaussianNetwork: "splatwire-scene-free-gaussians"
}  # fmt: skip
_ASSETS = Path(str(resources.files("splatwire").joinpath("assets")))
SHIPPED = (_ASSETS / "scene_free.safetensors", _ASSETS / "scene_free_gaussians.safetensors")
"""Weight files that ship with the package: for anchors, and for explicit Gaussians."""
_MAX_HIDDEN = 1024
Network = TypeVar("Network", AnchorNetwork, GaussianNetwork)


def save_network(network: Perceptron, path: Path, *, record: dict[str, str] | None = None) -> None:
    """Writes the weights of a network of the concealer `scene_free` to a file.

    Args:
        network: The network.
        path: Path of the file; its folder must exist.
        record: Training parameters, stored in the header.

    Raises:
        OSError: If the file cannot be written.
    """
    header = {"format": _FORMATS[type(network)], "version": VERSION, "record": record or {}}
    write_tensors(_arrays(network), header, path)


def load_anchor_network(path: Path) -> AnchorNetwork:
    """Reads the network of the concealer `scene_free` for anchors from a file.

    Raises:
        UnsupportedVersionError: If this release does not support the file's version.
        BitstreamError: If the file is absent, damaged or of another format.
    """
    return _load(path, AnchorNetwork)


def load_gaussian_network(path: Path) -> GaussianNetwork:
    """Reads the network of the concealer `scene_free` for explicit Gaussians from a file."""
    return _load(path, GaussianNetwork)


def _arrays(network: Perceptron) -> dict[str, np.ndarray]:
    """Returns the weight arrays of a network by their names in the file."""
    arrays = {"mean": network.mean, "spread": network.spread}
    for name, layer in (("layers.0", network.hidden), ("layers.2", network.output)):
        arrays |= {f"{name}.weight": layer.weight, f"{name}.bias": layer.bias}
    return arrays


def _load(path: Path, kind: type[Network]) -> Network:
    arrays, _ = read_tensors(path, _FORMATS[kind], VERSION)
    first = arrays.get("layers.0.weight")
    if first is None or first.ndim != 2 or not 1 <= len(first) <= _MAX_HIDDEN:
        raise BitstreamError(f"{path}: the first layer of the network is missing or of no sensible size")
    wanted = _arrays(kind.untrained(len(first)))
    if set(arrays) != set(wanted):
        odd = sorted(set(arrays) ^ set(wanted))
        raise BitstreamError(f"{path}: tensors of the network are missing or unknown: {', '.join(odd[:3])}")
    for name, model in wanted.items():
        array = arrays[name]
        if array.shape != model.shape or array.dtype.kind != "f":
            raise BitstreamError(f"{path}: '{name}' is {array.dtype} {array.shape}, not {model.shape}")
        if not np.isfinite(array).all():
            raise BitstreamError(f"{path}: '{name}' of the network is not finite")
    if not (arrays["spread"] > 0).all():
        raise BitstreamError(f"{path}: 'spread' of the network is not positive")
    narrow = {name: values.astype(np.float32) for name, values in arrays.items()}
    hidden, output = (Linear(narrow[f"{name}.weight"], narrow[f"{name}.bias"]) for name in ("layers.0", "layers.2"))
    return kind(narrow["mean"], narrow["spread"], hidden, output)


@cache
def default_anchor_weights() -> AnchorNetwork:
    """Returns the shipped neural network of the concealer `scene_free` for scenes of anchors."""
    return load_anchor_network(SHIPPED[0])


@cache
def default_gaussian_weights() -> GaussianNetwork:
    """Returns the shipped neural network of the concealer `scene_free` for scenes of explicit Gaussians."""
    return load_gaussian_network(SHIPPED[1])
