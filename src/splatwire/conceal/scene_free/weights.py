"""Weights of the scene-free concealer as files of plain tensors; one for each kind of elements comes along."""

from functools import cache
from importlib import resources
from pathlib import Path
from typing import TypeVar

from splatwire.conceal.scene_free.elements import ElementNetwork
from splatwire.conceal.scene_free.network import GainNetwork, Perceptron
from splatwire.errors import BitstreamError
from splatwire.model.tensor_file import load_tensors, read_tensors, write_tensors

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
    tensors = {name: value.detach().float().contiguous() for name, value in network.state_dict().items()}
    write_tensors(tensors, {"format": _FORMATS[type(network)], "version": VERSION, "record": record or {}}, path)


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


def _load(path: Path, kind: type[Network]) -> Network:
    tensors, _ = read_tensors(path, _FORMATS[kind], VERSION)
    first = tensors.get("layers.0.weight")
    if first is None or first.dim() != 2 or not 1 <= len(first) <= _MAX_HIDDEN:
        raise BitstreamError(f"{path}: the first layer of the gain network is missing or of no sensible size")
    network = kind(len(first))
    load_tensors(network, tensors, f"{path}: ")
    if not bool((tensors["spread"] > 0).all()):
        raise BitstreamError(f"{path}: 'spread' of the gain network is not positive")
    return network.eval().requires_grad_(False)


@cache
def default_weights() -> GainNetwork:
    """The network for anchors that ships with the package."""
    return load_gain_network(SHIPPED[0])


@cache
def default_element_weights() -> ElementNetwork:
    """The network for explicit Gaussians that ships with the package."""
    return load_element_network(SHIPPED[1])
