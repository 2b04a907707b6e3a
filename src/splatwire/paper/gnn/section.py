"""The section `gnn` of the side information: weights of the inpainting network for the stream's scene.

Layout:

* version, `u8` (2);
* the first 8 bytes of the SHA-256 over the layout and positions of the anchors (`scene_fingerprint`);
* neighbours, width, layers and heads (`GnnSettings`) as varints;
* cross-attention (0 or 1), metric, interpolation, query input and baseline (`GnnSettings`), one byte each;
* clip, sharpness and three thresholds as `f64`;
* constants that standardise the network's inputs for known anchors: the standard deviation of each input, then its mean
  in sixteenths of the standard deviation. A standard deviation is stored as an integer `index`, which stands for
  `(1 + (index mod 8) / 8) * 2 ** floor(index / 8)`;
* the same constants for lost anchors;
* all parameters in the order of the network. The output layer (head) of an attribute is left out if the attribute's
  confidence threshold is above 1, because its output is then never used.

A vector is stored as integers in units of 1/128. A matrix has three parts: the index of its quantisation step (same
formula as for standard deviations), the index of the coding scale of each row, and the quantised integers. The integers
have at most 8 bits. They are entropy-coded with a zero-mean normal distribution; its standard deviation is the coding
scale of the row.
"""

from typing import Any

from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes
from splatwire.paper.gnn.quantise import check_bits, read_parameters, write_parameters
from splatwire.paper.gnn.settings import BASELINES, INTERPOLATIONS, METRICS, QUERY_INPUTS, GnnSettings
from splatwire.paper.gnn.weights import GnnWeights, scene_fingerprint
from splatwire.types import AnchorLayout, Prior, ReceivedScene

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
    """Returns the bytes of the section `gnn` with the quantised weights of an inpainting network.

    Args:
        weights: The trained network.
        bits: Approximate bits per weight, 2 to 6.

    Raises:
        InvalidValueError: If the network is too large, a weight is not finite, or the confidence thresholds of all
            attributes are above 1, so that receivers would never use the network.
    """
    # The heads of attributes with a threshold above 1 are omitted, because a receiver does not use them.
    check_bits(bits)
    settings = weights.settings
    if not weights.is_used:
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


def read_section(data: bytes, context: ReceivedScene) -> GnnWeights:
    """Reads the weights of an inpainting network from a section written by `write_section`.

    Args:
        data: Bytes of the section.
        context: The decoded scene of the stream.

    Raises:
        UnsupportedVersionError: If a newer release wrote the section.
        InvalidValueError: If the weights are of another scene.
        BitstreamError: If the section is damaged.
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
            InputSizes(context[AnchorLayout], context[Prior].context_features.shape[1]), _read_settings(reader)
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


def rounded_weights(weights: GnnWeights, context: ReceivedScene, bits: int) -> GnnWeights:
    """Returns the weights after quantisation to about `bits` bits per weight, exactly as a receiver reads them."""
    received = read_section(write_section(weights, bits), context)
    return GnnWeights(received.network, weights.fingerprint, weights.validation)
