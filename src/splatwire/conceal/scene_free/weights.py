"""Weights of the scene-free concealer as files of plain arrays; the package ships one for each kind of elements."""

from functools import cache
from importlib import resources
from pathlib import Path
from typing import TypeVar

import numpy as np

from splatwire.conceal.scene_free.elements import ElementNetwork
from splatwire.conceal.scene_free.network import GainNetwork, Perceptron
from splatwire.errors import BitstreamError
from splatwire.model.networks import Linear
from splatwire.model.tensor_file import read_tensors, write_tensors

VERSION = 1
_FORMATS: dict[type[Perceptron], str] = {
    GainNetwork: "splatwire-scene-free", ElementNetwork: "splatwire-scene-free-gaussians"
}  # fmt: skip
_ASSETS = Path(str(resources.files("splatwire").joinpath("assets")))
SHIPPED = (_ASSETS / "scene_free.safetensors", _ASSETS / "scene_free_gaussians.safetensors")
"""The package's files, for anchors and for explicit Gaussians."""
_MAX_HIDDEN = 1024
Network = TypeVar("Network", GainNetwork, ElementNetwork)


def save_gain_network(network: Perceptron, path: Path, *, record: dict[str, str] | None = None) -> None:
    """Writes a network.

    Args:
        network: What to write.
        path: Where; its folder must exist.
        record: How it was trained, kept in the header.

    Raises:
        OSError: If the file cannot be written.
    """
    header = {"format": _FORMATS[type(network)], "version": VERSION, "record": record or {}}
    write_tensors(_arrays(network), header, path)


def load_gain_network(path: Path) -> GainNetwork:
    """Reads a network for anchors that `save_gain_network` wrote.

    Raises:
        UnsupportedVersionError: If it is of a version that this release does not read.
        BitstreamError: If it is absent or no such file, or a tensor is missing, of another size or not finite.
    """
    return _load(path, GainNetwork)


def load_element_network(path: Path) -> ElementNetwork:
    """Reads a network for explicit Gaussians; see `load_gain_network`."""
    return _load(path, ElementNetwork)


def _arrays(network: Perceptron) -> dict[str, np.ndarray]:
    """Arrays of a network by the names that they have in files."""
    arrays = {"mean": network.mean, "spread": network.spread}
    for name, layer in (("layers.0", network.hidden), ("layers.2", network.output)):
        arrays |= {f"{name}.weight": layer.weight, f"{name}.bias": layer.bias}
    return arrays


def _load(path: Path, kind: type[Network]) -> Network:
    arrays, _ = read_tensors(path, _FORMATS[kind], VERSION)
    first = arrays.get("layers.0.weight")
    if first is None or first.ndim != 2 or not 1 <= len(first) <= _MAX_HIDDEN:
        raise BitstreamError(f"{path}: the first layer of the gain network is missing or of no sensible size")
    wanted = _arrays(kind.untrained(len(first)))
    if set(arrays) != set(wanted):
        odd = sorted(set(arrays) ^ set(wanted))
        raise BitstreamError(f"{path}: tensors of the network are missing or unknown: {', '.join(odd[:3])}")
    for name, model in wanted.items():
        found = arrays[name]
        if found.shape != model.shape or found.dtype.kind != "f":
            raise BitstreamError(f"{path}: '{name}' is {found.dtype} {found.shape}, not {model.shape}")
        if not np.isfinite(found).all():
            raise BitstreamError(f"{path}: '{name}' of the network is not finite")
    if not (arrays["spread"] > 0).all():
        raise BitstreamError(f"{path}: 'spread' of the gain network is not positive")
    narrow = {name: values.astype(np.float32) for name, values in arrays.items()}
    hidden, output = (Linear(narrow[f"{name}.weight"], narrow[f"{name}.bias"]) for name in ("layers.0", "layers.2"))
    return kind(narrow["mean"], narrow["spread"], hidden, output)


@cache
def default_weights() -> GainNetwork:
    """The network for anchors that ships with the package."""
    return load_gain_network(SHIPPED[0])


@cache
def default_element_weights() -> ElementNetwork:
    """The network for explicit Gaussians that ships with the package."""
    return load_element_network(SHIPPED[1])
