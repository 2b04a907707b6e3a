"""Packets of schema `causal` in plain Python and torch integers: what fast code is compared with."""

from fractions import Fraction

import torch
from torch import Tensor

from splatwire.codec.fixed_point import ACTIVATION_BITS, ACTIVATION_LIMIT, OUTPUT_BITS, OUTPUT_LIMIT, WEIGHT_EXPONENT
from splatwire.codec.integer_network import IntegerLinear, IntegerMlp
from splatwire.codec.schemas.causal.context import CodingContext
from splatwire.entropy.reference import ReferenceDecoder, ReferenceMixture, decode_mixture
from splatwire.entropy.tables import weight_table
from splatwire.model.causal import OCTAVES

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

    def sums(layer: IntegerLinear, values: Tensor) -> Tensor:
        return torch.from_numpy(layer.weight) @ values + torch.from_numpy(layer.bias)

    hidden = sums(network.hidden, torch.tensor(inputs)) >> WEIGHT_EXPONENT
    below = (hidden * LEAK) >> 16 if network.leaky else torch.zeros_like(hidden)
    hidden = torch.where(hidden > 0, hidden, below).clamp(-ACTIVATION_LIMIT, ACTIVATION_LIMIT)
    shift = ACTIVATION_BITS + WEIGHT_EXPONENT - OUTPUT_BITS
    return (sums(network.output, hidden) >> shift).clamp(-OUTPUT_LIMIT, OUTPUT_LIMIT).tolist()


def scale_reference(spread: int) -> int:
    """Entry of the scale table of a binary logarithm with 16 fractional bits."""
    whole, cell = (spread + (6 << 16)) >> 16, ((spread + (6 << 16)) >> 8) & 255
    return min(max(16 * whole + int(16 * (2 ** (cell / 256) - 1)), 0), 319)


def decode_reference(
    context: CodingContext, voxels: list[list[int]], payload: bytes
) -> tuple[list[list[int]], list[list[int]]]:
    """Masks and numbers of a packet's anchors.

    Args:
        context: What packets are predicted from.
        voxels: Places of its anchors.
        payload: The packet's.
    """
    layout, coder = context.config.layout, ReferenceDecoder(payload)
    places = [network_reference(context.networks["position"], place_inputs_reference(v, context)) for v in voxels]
    known = [[value >> (OUTPUT_BITS - ACTIVATION_BITS) for value in place] for place in places]
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
    return masks, numbers


def _decode_mask(coder: ReferenceDecoder, one: int) -> int:
    exists = coder.target(16) < one
    coder.advance(*((0, one) if exists else (one, (1 << 16) - one)), 16)
    return int(exists)


def mask_weight(logit: int) -> int:
    """How probable it is that an offset exists, out of 2**16."""
    index = min(max(((logit + 2048) >> 12) + 128, 0), 255)
    return min(max(int(weight_table()[index]), 32), 65504)
