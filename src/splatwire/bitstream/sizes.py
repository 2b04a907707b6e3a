"""Sizes of a stream: manifest, side information and packets."""

import statistics
from dataclasses import asdict, dataclass, field
from typing import Any

from splatwire.arguments import CheckedFields, checked
from splatwire.bitstream.scene_stream import SceneStream


@dataclass(frozen=True)
class StreamSizes(CheckedFields):
    """Sizes of a stream in bytes; packet headers are included.

    Attributes:
        num_bytes: Size of the stream as one file.
        parts: Bytes of each part of the file, by name.
        num_elements: Number of elements of the complete scene.
        num_packets: Number of available packets.
        packet_min: Size of the smallest packet; 0 without packets.
        packet_median: Median packet size.
        packet_max: Size of the largest packet.
        bytes_per_element: Bytes per element of the complete scene.
        tiers: Sizes of each importance tier: `num_elements`, `lanes` (packets per block), `num_packets` and
            `packet_bytes`. The keys of `tiers` are the numbers of the tiers as text. Empty for a single tier.
    """

    num_bytes: int
    parts: dict[str, int]
    num_elements: int
    num_packets: int
    packet_min: int
    packet_median: float
    packet_max: int
    bytes_per_element: float
    tiers: dict[str, dict[str, int]] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Returns the sizes as numbers and strings, for JSON."""
        return asdict(self)


@checked
def measure_sizes(stream: SceneStream) -> StreamSizes:
    """Returns the sizes of the parts and importance tiers of a stream."""
    sizes = [packet.num_bytes for packet in stream.packets] or [0]
    num_elements = stream.manifest.num_elements
    return StreamSizes(
        num_bytes=stream.num_bytes,
        parts=stream.part_sizes(),
        num_elements=num_elements,
        num_packets=len(stream.packets),
        packet_min=min(sizes),
        packet_median=float(statistics.median(sizes)),
        packet_max=max(sizes),
        bytes_per_element=stream.num_bytes / num_elements if num_elements else 0.0,
        tiers=_by_tier(stream),
    )


def _by_tier(stream: SceneStream) -> dict[str, dict[str, int]]:
    plan = stream.manifest.plan
    tiers = [
        {"num_elements": counts.num_elements, "lanes": counts.lanes, "num_packets": 0, "packet_bytes": 0}
        for counts in plan.tiers
    ]
    for packet in stream.packets if tiers else ():
        tier = tiers[plan.tier_of(packet.id.block)]
        tier["num_packets"] += 1
        tier["packet_bytes"] += packet.num_bytes
    return {str(number): tier for number, tier in enumerate(tiers)}
