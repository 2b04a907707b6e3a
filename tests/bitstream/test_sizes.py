import json

import pytest

from splatwire.bitstream import Packetization, measure_sizes, stream_to_bytes


def test_sizes_add_up_to_the_file_size(stream):
    sizes = measure_sizes(stream)
    assert sizes.num_bytes == sum(sizes.parts.values()) == len(stream_to_bytes(stream))
    packet_bytes = sorted(16 + len(packet.payload) for packet in stream.packets)
    assert (sizes.packet_min, sizes.packet_max) == (packet_bytes[0], packet_bytes[-1])
    assert sizes.packet_median == (packet_bytes[13] + packet_bytes[14]) / 2
    assert sizes.bytes_per_element == pytest.approx(sizes.num_bytes / 700)
    assert json.loads(json.dumps(sizes.to_json()))["num_packets"] == 28


def test_sizes_of_an_empty_stream_are_zero(stream, make_test_stream):
    sizes = measure_sizes(stream.with_packets(()))
    assert (sizes.num_packets, sizes.packet_min, sizes.packet_median, sizes.packet_max) == (0, 0, 0, 0)
    assert measure_sizes(make_test_stream(num_elements=0, packetization=Packetization())).bytes_per_element == 0
