"""Determines which Gaussians share a packet, for simulating packet loss during fine-tuning."""

from dataclasses import dataclass

import numpy as np

from splatwire.bitstream import HEADER_BYTES, Packetization
from splatwire.codec.gaussians.encoder import GaussianEncoder, prepare_splats
from splatwire.codec.schema import Options
from splatwire.types import SplatScene


@dataclass(frozen=True, eq=False)
class PacketDivision:
    """Division of a scene's Gaussians into packets, with packets numbered in sending order.

    Attributes:
        packet: Packet of each Gaussian, int64 (N).
        num_bytes: Size of each packet with its header, int64 (P).
    """

    packet: np.ndarray
    num_bytes: np.ndarray


def divide_into_packets(scene: SplatScene, packetization: Packetization) -> PacketDivision:
    """Encodes Gaussians to find out which packet contains each Gaussian, and how large the packets are.

    Args:
        scene: The Gaussians; each must have a visible effect.
        packetization: Parameters of the division into packets.

    Raises:
        InvalidValueError: If the packetization does not apply to explicit Gaussians.
    """
    prepared = prepare_splats(scene, Options(packetization))
    encoder = prepared.encoder
    assert isinstance(encoder, GaussianEncoder)
    packet, sizes, keys, total = np.zeros(scene.num_elements, np.int64), list[int](), list[tuple[int, int]](), 0
    for block in encoder.batches():
        coded = encoder.encode(block)
        members = encoder.coding_order(block, coded.counts)
        packet[members] = total + np.repeat(np.arange(len(coded.counts)), coded.counts)
        sizes += [len(payload) + HEADER_BYTES for payload in coded.payloads]
        keys += [(index_in_block, block) for index_in_block in range(len(coded.counts))]
        total += len(coded.counts)
    order = sorted(range(total), key=keys.__getitem__)
    sending_index = np.empty(total, np.int64)
    sending_index[order] = np.arange(total)
    return PacketDivision(sending_index[packet], np.array(sizes, np.int64)[order])
