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
        packet_of_gaussian: Index of the packet of each Gaussian, int64 (N).
        num_bytes: Size of each packet with its header, int64 (P).
    """

    packet_of_gaussian: np.ndarray
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
    packet_of_gaussian, num_packets = np.zeros(scene.num_elements, np.int64), 0
    sizes, keys = list[int](), list[tuple[int, int]]()
    for block in encoder.batches():
        coded = encoder.encode(block)
        members = encoder.packet_order(block, coded.counts)
        packet_of_gaussian[members] = num_packets + np.repeat(np.arange(len(coded.counts)), coded.counts)
        sizes += [len(payload) + HEADER_BYTES for payload in coded.payloads]
        keys += [(index_in_block, block) for index_in_block in range(len(coded.counts))]
        num_packets += len(coded.counts)
    order = sorted(range(num_packets), key=keys.__getitem__)
    sending_index = np.empty(num_packets, np.int64)
    sending_index[order] = np.arange(num_packets)
    return PacketDivision(sending_index[packet_of_gaussian], np.array(sizes, np.int64)[order])
