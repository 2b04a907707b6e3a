"""Trained weights as one file of plain tensors (safetensors) that knows the scene it belongs to."""

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from splatwire.conceal.context import AnchorContext
from splatwire.conceal.gnn.network import InpaintingNetwork, InputSizes
from splatwire.conceal.gnn.settings import GnnSettings
from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.model.tensor_file import write_tensors
from splatwire.scene import AnchorLayout

FORMAT = "splatwire-gnn"
VERSION = 1
FINGERPRINT_DIGITS = 16
PRECISIONS = {"float32": torch.float32, "float16": torch.float16}


@dataclass(frozen=True, eq=False)
class GnnWeights:
    """A trained network and where it may be used.

    Attributes:
        network: The network, in evaluation.
        fingerprint: `scene_fingerprint` of its scene, or at least the first 16 digits of it.
        validation: What calibration measured on held-out losses, for the record.
    """

    network: InpaintingNetwork
    fingerprint: str
    validation: dict[str, float]

    @property
    def settings(self) -> GnnSettings:
        """How it is built and used."""
        return self.network.settings

    @property
    def improves(self) -> bool:
        """Whether any attribute is ever taken from the network."""
        settings = self.settings
        return min(settings.feature_threshold, settings.scaling_threshold, settings.offset_threshold) <= 1


def scene_fingerprint(context: AnchorContext) -> str:
    """SHA-256 of what a receiver knows of a scene whatever was lost: the positions in order, and the layout."""
    digest = hashlib.sha256(b"splatwire/gnn-scene/1\0")
    digest.update(f"{context.layout} {context.prior.context.shape[1]}".encode())
    digest.update(context.anchors.positions.detach().cpu().contiguous().numpy().astype("<f4").tobytes())
    return digest.hexdigest()


def check_fits(weights: GnnWeights, context: AnchorContext) -> None:
    """Refuses weights of another scene.

    Raises:
        InvalidValueError: If the sizes of an anchor or the scene differ.
    """
    sizes = weights.network.sizes
    if sizes != InputSizes(context.layout, context.prior.context.shape[1]):
        raise InvalidValueError(
            f"these GNN weights are for anchors of {sizes.layout} with {sizes.context_dim} hash features, "
            f"not {context.layout} with {context.prior.context.shape[1]}"
        )
    if not scene_fingerprint(context).startswith(weights.fingerprint):
        raise InvalidValueError("these GNN weights were calibrated on another scene; calibrate this one")


def save_weights(weights: GnnWeights, path: Path, *, precision: str = "float32") -> None:
    """Writes weights; the file appears under its name only when it is complete.

    Args:
        weights: What to write.
        path: Where; its folder must exist.
        precision: `float32`, or `float16` for half the bytes.

    Raises:
        InvalidValueError: If there is no such precision.
        OSError: If the file cannot be written.
    """
    if precision not in PRECISIONS:
        raise InvalidValueError(f"precision must be one of {', '.join(PRECISIONS)}, not {precision!r}")
    sizes = weights.network.sizes
    header = {
        "format": FORMAT,
        "version": VERSION,
        "settings": dataclasses.asdict(weights.settings),
        "layout": dataclasses.asdict(sizes.layout),
        "context_dim": sizes.context_dim,
        "fingerprint": weights.fingerprint,
        "validation": weights.validation,
    }
    state = weights.network.state_dict()
    tensors = {name: value.detach().to("cpu", PRECISIONS[precision]).contiguous() for name, value in state.items()}
    write_tensors(tensors, header, path)


def read_tensors(path: Path, form: str, version: int) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Reads what `write_tensors` wrote.

    Raises:
        UnsupportedVersionError: If it is of a version that this release does not read.
        BitstreamError: If it is absent, damaged or something else.
    """
    try:
        with safe_open(path, framework="pt") as file:
            text = (file.metadata() or {}).get("splatwire")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dictionary
        header = json.loads(text or "null")
    except FileNotFoundError as error:
        raise BitstreamError(f"{path}: no such file") from error
    except (SafetensorError, OSError, ValueError) as error:
        raise BitstreamError(f"{path}: not a file of {form}: {error}") from error
    if not isinstance(header, dict) or header.get("format") != form:
        raise BitstreamError(f"{path}: not a file of {form}")
    if header.get("version") != version:
        raise UnsupportedVersionError(f"{path}: version {header.get('version')} of {form} is not read")
    return tensors, header


def load_weights(path: Path) -> GnnWeights:
    """Reads what `save_weights` wrote.

    Raises:
        UnsupportedVersionError: If it is of a version that this release does not read.
        BitstreamError: If it is absent or no weights file, or a tensor is missing, of another size or not finite.
    """
    tensors, header = read_tensors(path, FORMAT, VERSION)
    try:
        layout = dict(header["layout"])
        sizes = InputSizes(
            AnchorLayout(**{**layout, "feature_groups": tuple(layout["feature_groups"])}), int(header["context_dim"])
        )
        network = InpaintingNetwork(sizes, GnnSettings(**header["settings"]))
        validation = {str(name): float(value) for name, value in header["validation"].items()}
        fingerprint = str(header["fingerprint"])
        if len(fingerprint) < FINGERPRINT_DIGITS:
            raise ValueError(f"fingerprint {fingerprint!r}")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BitstreamError(f"{path}: the header of the GNN weights is damaged: {error}") from error
    load_tensors(network, tensors, f"{path}: ")
    return GnnWeights(network.eval().requires_grad_(False), fingerprint, validation)


def load_tensors(network: InpaintingNetwork, tensors: dict[str, Tensor], where: str) -> None:
    """Puts tensors into a network, strictly.

    Raises:
        BitstreamError: If one is missing, too many, of another size, or not finite.
    """
    wanted = network.state_dict()
    if set(tensors) != set(wanted):
        odd = sorted(set(tensors) ^ set(wanted))
        raise BitstreamError(f"{where}tensors of the GNN weights are missing or unknown: {', '.join(odd[:3])}")
    for name, value in wanted.items():
        found = tensors[name]
        if found.shape != value.shape or not found.dtype.is_floating_point:
            raise BitstreamError(f"{where}'{name}' is {found.dtype} {tuple(found.shape)}, not {tuple(value.shape)}")
        if not bool(found.isfinite().all()):
            raise BitstreamError(f"{where}'{name}' of the GNN weights is not finite")
    network.load_state_dict({name: value.float() for name, value in tensors.items()})
