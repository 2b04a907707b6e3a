"""Trained weights as one file of plain tensors (safetensors) that knows the scene it belongs to."""

import dataclasses
import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from splatwire.errors import MALFORMED, BitstreamError, InvalidValueError
from splatwire.model import Partial, Prior
from splatwire.model.tensor_file import read_tensors, write_tensors
from splatwire.model.tensors import check_tensors, load_tensors, to_tensors
from splatwire.ops.arrays import to_numpy
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes
from splatwire.paper.gnn.settings import GnnSettings
from splatwire.scene import AnchorLayout

FORMAT = "splatwire-gnn"
VERSION = 2
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


def scene_fingerprint(context: Partial) -> str:
    """SHA-256 of what a receiver knows of a scene whatever was lost: the positions in order, and the layout."""
    digest = hashlib.sha256(b"splatwire/gnn-scene/1\0")
    digest.update(f"{context[AnchorLayout]} {context[Prior].context.shape[1]}".encode())
    digest.update(np.ascontiguousarray(to_numpy(context.places), "<f4").tobytes())
    return digest.hexdigest()


def check_fits(weights: GnnWeights, context: Partial) -> None:
    """Refuses weights of another scene.

    Raises:
        InvalidValueError: If the sizes of an anchor or the scene differ.
    """
    sizes = weights.network.sizes
    if sizes != InputSizes(context[AnchorLayout], context[Prior].context.shape[1]):
        raise InvalidValueError(
            f"these GNN weights are for anchors of {sizes.layout} with {sizes.context_dim} hash features, "
            f"not {context[AnchorLayout]} with {context[Prior].context.shape[1]}"
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


def load_weights(path: Path) -> GnnWeights:
    """Reads what `save_weights` wrote.

    Raises:
        UnsupportedVersionError: If it is of a version that this release does not read.
        BitstreamError: If it is absent or no weights file, or a tensor is missing, of another size or not finite.
    """
    arrays, header = read_tensors(path, FORMAT, VERSION)
    tensors = to_tensors(arrays)
    try:
        layout = dict(header["layout"])
        sizes = InputSizes(
            AnchorLayout(**{**layout, "feature_groups": tuple(layout["feature_groups"])}), int(header["context_dim"])
        )
        if sizes.context_dim < 1:
            raise ValueError(f"a hash-grid feature of {sizes.context_dim} channels")
        settings = GnnSettings(**header["settings"])
        with torch.device("meta"):  # shapes without memory: the header may promise more than its tensors are
            check_tensors(InpaintingNetwork(sizes, settings), tensors, f"{path}: ")
        network = InpaintingNetwork(sizes, settings)
        validation = {str(name): float(value) for name, value in header["validation"].items()}
        fingerprint = str(header["fingerprint"])
        if len(fingerprint) < FINGERPRINT_DIGITS:
            raise ValueError(f"fingerprint {fingerprint!r}")
    except MALFORMED as error:
        raise BitstreamError(f"{path}: the header of the GNN weights is damaged: {error}") from error
    load_tensors(network, tensors, f"{path}: ")
    return GnnWeights(network.eval().requires_grad_(False), fingerprint, validation)
