"""File of trained weights of the inpainting network: tensors (safetensors) with a fingerprint of the scene."""

import dataclasses
import hashlib
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from splatwire.anchors.tensor_file import read_tensors, write_tensors
from splatwire.errors import MALFORMED, BitstreamError, InvalidValueError
from splatwire.neural.model.tensors import check_tensors, load_tensors, to_tensors
from splatwire.ops.arrays import to_numpy
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes
from splatwire.paper.gnn.settings import GnnSettings
from splatwire.types import AnchorLayout, Prior, ReceivedScene

FORMAT = "splatwire-gnn"
VERSION = 2
FINGERPRINT_DIGITS = 16
PRECISIONS = {"float32": torch.float32, "float16": torch.float16}


@dataclass(frozen=True, eq=False)
class GnnWeights:
    """A trained network and the scene for which it is valid.

    Attributes:
        network: The network, in evaluation mode.
        fingerprint: Hash of the scene, from `scene_fingerprint`.
        validation: Errors on held-out packet losses; only for information.
    """

    # A fingerprint read from a stream has only the first 16 digits.

    network: InpaintingNetwork
    fingerprint: str
    validation: dict[str, float]

    @property
    def settings(self) -> GnnSettings:
        """Settings of the network, and of how the concealer uses the network's outputs."""
        return self.network.settings

    @property
    def is_used(self) -> bool:
        """True if the network's output is used for at least one attribute."""
        # An attribute with a confidence threshold above 1 always uses the interpolation.
        settings = self.settings
        return min(settings.feature_threshold, settings.scaling_threshold, settings.offset_threshold) <= 1

    @property
    def improves(self) -> bool:
        """Deprecated name of `is_used`."""
        warnings.warn("GnnWeights.improves is deprecated, use is_used", DeprecationWarning, stacklevel=2)
        return self.is_used


def scene_fingerprint(context: ReceivedScene) -> str:
    """Returns a hash that identifies a scene: SHA-256 (hex) of the layout and positions of its anchors.

    A receiver knows layout and positions even if packets are lost.
    """
    digest = hashlib.sha256(b"splatwire/gnn-scene/1\0")
    digest.update(f"{context[AnchorLayout]} {context[Prior].context_features.shape[1]}".encode())
    digest.update(np.ascontiguousarray(to_numpy(context.positions), "<f4").tobytes())
    return digest.hexdigest()


def check_fits(weights: GnnWeights, context: ReceivedScene) -> None:
    """Checks that weights were trained for this scene.

    Raises:
        InvalidValueError: If the layout of the anchors or the fingerprint differs.
    """
    sizes = weights.network.sizes
    if sizes != InputSizes(context[AnchorLayout], context[Prior].context_features.shape[1]):
        raise InvalidValueError(
            f"these GNN weights are for anchors of {sizes.layout} with {sizes.context_dim} hash features, "
            f"not {context[AnchorLayout]} with {context[Prior].context_features.shape[1]}"
        )
    if not scene_fingerprint(context).startswith(weights.fingerprint):
        raise InvalidValueError("these GNN weights were calibrated on another scene; calibrate this one")


def save_weights(weights: GnnWeights, path: Path, *, precision: str = "float32") -> None:
    """Writes the weights of an inpainting network to a file, atomically.

    Args:
        weights: The trained network with the fingerprint of its scene.
        path: Path of the file; its folder must exist.
        precision: `float32`, or `float16` for half the bytes.

    Raises:
        InvalidValueError: If the precision is unknown.
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
    """Reads the weights of an inpainting network from a file written by `save_weights`.

    Raises:
        UnsupportedVersionError: If this release does not support the file's version.
        BitstreamError: If the file is absent or not a weights file, or a tensor is missing, of another size or not
            finite.
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
        with torch.device("meta"):  # only shapes, no memory: the header may state too large sizes
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
