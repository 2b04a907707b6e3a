"""Weights of the scene-free concealer as a file of plain tensors; one such file ships with the package."""

from functools import cache
from importlib import resources
from pathlib import Path

from splatwire.conceal.scene_free.network import GainNetwork
from splatwire.errors import BitstreamError
from splatwire.model.tensor_file import load_tensors, read_tensors, write_tensors

FORMAT = "splatwire-scene-free"
VERSION = 1
SHIPPED = Path(str(resources.files("splatwire").joinpath("assets").joinpath("scene_free.safetensors")))
_MAX_HIDDEN = 1024


def save_gain_network(network: GainNetwork, path: Path, *, record: dict[str, str] | None = None) -> None:
    """Writes a network.

    Args:
        network: What to write.
        path: Where; its folder must exist.
        record: How it was trained, kept in the header.

    Raises:
        OSError: If the file cannot be written.
    """
    tensors = {name: value.detach().float().contiguous() for name, value in network.state_dict().items()}
    write_tensors(tensors, {"format": FORMAT, "version": VERSION, "record": record or {}}, path)


def load_gain_network(path: Path) -> GainNetwork:
    """Reads what `save_gain_network` wrote.

    Raises:
        UnsupportedVersionError: If it is of a version that this release does not read.
        BitstreamError: If it is absent or no such file, or a tensor is missing, of another size or not finite.
    """
    tensors, _ = read_tensors(path, FORMAT, VERSION)
    first = tensors.get("layers.0.weight")
    if first is None or first.dim() != 2 or not 1 <= len(first) <= _MAX_HIDDEN:
        raise BitstreamError(f"{path}: the first layer of the gain network is missing or of no sensible size")
    network = GainNetwork(len(first))
    load_tensors(network, tensors, f"{path}: ")
    if not bool((tensors["spread"] > 0).all()):
        raise BitstreamError(f"{path}: 'spread' of the gain network is not positive")
    return network.eval().requires_grad_(False)


@cache
def default_weights() -> GainNetwork:
    """The network that ships with the package."""
    return load_gain_network(SHIPPED)
