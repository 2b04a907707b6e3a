"""Packets of schema `causal` in plain Python and torch integers, the reference of the fast code."""

import bisect
from fractions import Fraction

import numpy as np

from reference.range_coder import ReferenceDecoder, ReferenceMixture, decode_mixture
from splatwire.codec.anchors.causal.context import CodingContext
from splatwire.codec.anchors.causal.positions import AnchorPositions
from splatwire.codec.fixed_point import ACTIVATION_BITS, ACTIVATION_LIMIT, OUTPUT_BITS, OUTPUT_LIMIT, WEIGHT_EXPONENT
from splatwire.codec.integer_network import IntegerLinear, IntegerMlp
from splatwire.entropy.tables import logistic_table
from splatwire.types.causal_coding import OCTAVES

LEAK = 655
"""Slope of a network below zero, out of 2**16."""


def place_inputs_reference(voxel: list[int], context: CodingContext) -> list[int]:
    """Inputs of the position network, with 14 fractional bits."""
    one, contracted = 1 << ACTIVATION_BITS, []
    for value, middle, spread in zip(voxel, context.middle.tolist(), context.spread.tolist(), strict=True):
        relative = ((value - middle) << ACTIVATION_BITS) // spread
        contracted.append((relative << ACTIVATION_BITS) // (one + abs(relative)))
    waves = list(contracted)
    for octave in range(1, OCTAVES + 1):
        for value in contracted:
            phase = Fraction((value << octave) - one, one) % 4
            waves.append(int((abs(phase - 2) - 1) * one))
    return waves


def network_reference(network: IntegerMlp, inputs: list[int]) -> list[int]:
    """Outputs of a network, with 16 fractional bits."""

    def sums(layer: IntegerLinear, values: np.ndarray) -> np.ndarray:
        return layer.weight @ values + layer.bias

    hidden = sums(network.hidden, np.array(inputs, np.int64)) >> WEIGHT_EXPONENT
    below = (hidden * LEAK) >> 16 if network.leaky else np.zeros_like(hidden)
    hidden = np.where(hidden > 0, hidden, below).clip(-ACTIVATION_LIMIT, ACTIVATION_LIMIT)
    shift = ACTIVATION_BITS + WEIGHT_EXPONENT - OUTPUT_BITS
    return (sums(network.output, hidden) >> shift).clip(-OUTPUT_LIMIT, OUTPUT_LIMIT).tolist()


def scale_reference(spread: int) -> int:
    """Index in the scale table for a binary logarithm with 16 fractional bits."""
    whole, cell = (spread + (6 << 16)) >> 16, ((spread + (6 << 16)) >> 8) & 255
    return min(max(16 * whole + int(16 * (2 ** (cell / 256) - 1)), 0), 319)


def code_reference(
    coder: ReferenceDecoder, code: int, num_low_bits: int, low_bit_probabilities: list[list[int]]
) -> int:
    """Bits of a position's code that are known without the packet; the `num_low_bits` others follow in the packet."""

    def raw(bits: int) -> int:
        value = coder.target(bits)
        coder.advance(value, 1, bits)
        return value

    triples, level = -(-num_low_bits // 3), 0
    while level < triples:
        stop = low_bit_probabilities[triples][level]
        if coder.target(8) < stop:
            coder.advance(0, stop, 8)
            break
        coder.advance(stop, 256 - stop, 8)
        level += 1
    rest = 0
    if level < triples:
        low = min(num_low_bits - 3 * level, 3)
        bits, above, value = num_low_bits - 3 * level - low, 0, 0
        while bits:
            bits, some = bits - min(bits, 16), min(bits, 16)
            above = above << some | raw(some)
        if low > 1:
            ends = [(i << 16) // (2**low - 1) for i in range(2**low)]
            value = bisect.bisect_right(ends, coder.target(16)) - 1
            coder.advance(ends[value], ends[value + 1] - ends[value], 16)
        rest = (above << low | value + 1) << 3 * level
    return code >> num_low_bits << num_low_bits | rest


def decode_reference(
    context: CodingContext, positions: AnchorPositions, payload: bytes
) -> tuple[list[int], list[list[int]], list[list[int]]]:
    """Position codes, masks and integers of a packet's anchors.

    Args:
        context: Coding context from the side information.
        positions: Known bits of its anchors' positions.
        payload: Payload of the packet.
    """
    layout, coder, low_bit_probabilities = (
        context.config.layout,
        ReferenceDecoder(payload),
        context.low_bit_probabilities.tolist(),
    )
    pairs = zip(positions.codes.tolist(), positions.num_low_bits.tolist(), strict=True)
    codes = [code_reference(coder, code, num_low_bits, low_bit_probabilities) for code, num_low_bits in pairs]
    voxels = [[_axis(code, axis) + int(positions.corner[axis]) for axis in range(3)] for code in codes]
    known = [network_reference(context.networks["position"], place_inputs_reference(v, context)) for v in voxels]
    known = [[value >> (OUTPUT_BITS - ACTIVATION_BITS) for value in place] for place in known]
    numbers: list[list[int]] = [[] for _ in voxels]
    masks: list[list[int]] = [[] for _ in voxels]

    def stage(name: str, size: int, skipped: int) -> None:
        for n in range(len(known) if name == "form" else 0):
            masks[n] = [_decode_mask(coder, mask_weight(logit)) for logit in outputs[n][:skipped]]
        for n, inputs in enumerate(known):
            mean, spread = outputs[n][skipped : skipped + size], outputs[n][skipped + size :]
            for c in range(size):
                there = name != "offset" or bool(masks[n][c // 3])
                symbol = decode_mixture(coder, ReferenceMixture(0, scale_reference(spread[c]))) if there else 0
                number = mean[c] + (min(max(symbol, -15360), 15360) << 16)
                numbers[n].append(number if there else 0)
                inputs.append(min(max(number >> 4, -ACTIVATION_LIMIT), ACTIVATION_LIMIT))

    plan = [(f"feature{g}", size, 0) for g, size in enumerate(layout.feature_groups)]
    plan += [("form", 1, layout.num_offsets), ("size", 3, 0), ("offset", 3 * layout.num_offsets, 0)]
    for name, size, skipped in plan:
        outputs = [network_reference(context.networks[name], inputs) for inputs in known]
        stage(name, size, skipped)
    return codes, masks, numbers


def _axis(code: int, axis: int) -> int:
    return sum((code >> (3 * bit + axis) & 1) << bit for bit in range(21))


def _decode_mask(coder: ReferenceDecoder, one: int) -> int:
    exists = coder.target(16) < one
    coder.advance(*((0, one) if exists else (one, (1 << 16) - one)), 16)
    return int(exists)


def mask_weight(logit: int) -> int:
    """Probability that an offset exists, out of 2**16."""
    index = min(max(((logit + 2048) >> 12) + 128, 0), 255)
    return min(max(int(logistic_table()[index]), 32), 65504)
