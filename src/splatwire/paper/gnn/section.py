"""The section `gnn` of the side information: a stream carries the weights of its own scene.

Version `u8` (2); the first 8 bytes of the SHA-256 over layout and positions; neighbours, width, layers and heads as
varints; whether there is cross-attention, metric, interpolation, input of the queries and baseline, a byte each; clip,
sharpness and three thresholds as `f64`. Then for known and for lost anchors the spreads of the inputs, as `index` of
`(1 + (index mod 8) / 8) * 2 ** floor(index / 8)`, and their means in sixteenths of the spread; then all parameters in
the order of the network, without the heads of attributes whose threshold is above 1: vectors in units of 1/128,
matrices as the index of their step (as for spreads), the scale index of each row, and integers of at most 8 bits under
a zero-mean normal of their row's scale.
"""

from typing import Any

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.model import Partial, Prior
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes
from splatwire.paper.gnn.quantise import check_bits, read_parameters, write_parameters
from splatwire.paper.gnn.settings import BASELINES, INTERPOLATIONS, METRICS, QUERY_INPUTS, GnnSettings
from splatwire.paper.gnn.weights import GnnWeights, scene_fingerprint
from splatwire.scene import AnchorLayout

SECTION = "gnn"
VERSION = 2
MAX_HIDDEN = 512
MAX_LAYERS = 8
_FINGERPRINT_BYTES = 8
_COUNTS = ("neighbors", "hidden", "layers", "heads")
_CHOICES = (
    ("metric", METRICS), ("interpolation", INTERPOLATIONS), ("query_input", QUERY_INPUTS), ("baseline", BASELINES)
)  # fmt: skip
_NUMBERS = ("clip", "sharpness", "feature_threshold", "scaling_threshold", "offset_threshold")


def write_section(weights: GnnWeights, bits: int) -> bytes:
    """Writes weights for the side information of their scene's stream.

    Args:
        weights: The network; heads of attributes with a threshold above 1 are left out.
        bits: Bits per weight, about: 2 to 6.

    Raises:
        InvalidValueError: If no attribute is ever taken from the network, it is too large, or a weight is not finite.
    """
    check_bits(bits)
    settings = weights.settings
    if not weights.improves:
        raise InvalidValueError("these GNN weights improve nothing on the interpolation: they are not worth a byte")
    if settings.hidden > MAX_HIDDEN or settings.layers > MAX_LAYERS:
        raise InvalidValueError(
            f"weights in a stream are at most {MAX_HIDDEN} wide with {MAX_LAYERS} layers, "
            f"not {settings.hidden} with {settings.layers}"
        )
    writer = ByteWriter()
    writer.u8(VERSION)
    for byte in bytes.fromhex(weights.fingerprint[: 2 * _FINGERPRINT_BYTES]):
        writer.u8(byte)
    for name in _COUNTS:
        writer.unsigned(getattr(settings, name))
    writer.u8(int(settings.cross_attention))
    for name, choices in _CHOICES:
        writer.u8(choices.index(getattr(settings, name)))
    for name in _NUMBERS:
        writer.f64(float(getattr(settings, name)))
    write_parameters(writer, weights.network, bits)
    return writer.bytes()


def read_section(data: bytes, context: Partial) -> GnnWeights:
    """Reads what `write_section` wrote.

    Args:
        data: The section.
        context: The scene that the stream holds; it gives the network's input sizes.

    Raises:
        UnsupportedVersionError: If a newer release wrote it.
        InvalidValueError: If the weights are of another scene.
        BitstreamError: If it is damaged.
    """
    reader = ByteReader(data, "GNN weights")
    version = reader.u8()
    if version != VERSION:
        raise UnsupportedVersionError(f"the stream's GNN weights have version {version}, this release reads {VERSION}")
    fingerprint = reader.take(_FINGERPRINT_BYTES).hex()
    if not scene_fingerprint(context).startswith(fingerprint):
        raise InvalidValueError("the GNN weights in this stream were calibrated on another scene; calibrate this one")
    try:
        network = InpaintingNetwork(
            InputSizes(context[AnchorLayout], context[Prior].context.shape[1]), _read_settings(reader)
        )
    except ValueError as error:
        raise BitstreamError(f"GNN weights: {error}") from error
    read_parameters(reader, network)
    reader.finish()
    return GnnWeights(network.eval().requires_grad_(False), fingerprint, {})


def _read_settings(reader: ByteReader) -> GnnSettings:
    counts: dict[str, Any] = {name: reader.unsigned() for name in _COUNTS}
    if counts["hidden"] > MAX_HIDDEN or counts["layers"] > MAX_LAYERS:
        raise BitstreamError(f"GNN weights: {counts['layers']} layers {counts['hidden']} wide are beyond the format")
    attention, choices = reader.u8() != 0, dict[str, Any]()
    for name, known in _CHOICES:
        place = reader.u8()
        if place >= len(known):
            raise BitstreamError(f"GNN weights: {name} {place} is unknown")
        choices[name] = known[place]
    numbers: dict[str, Any] = {name: reader.f64() for name in _NUMBERS}
    if not all(abs(value) < 1e9 for value in numbers.values()):
        raise BitstreamError("GNN weights: a threshold is not finite")
    return GnnSettings(**counts, **choices, **numbers, cross_attention=attention)


def rounded_weights(weights: GnnWeights, context: Partial, bits: int) -> GnnWeights:
    """The weights exactly as a receiver will read them."""
    received = read_section(write_section(weights, bits), context)
    return GnnWeights(received.network, weights.fingerprint, weights.validation)
