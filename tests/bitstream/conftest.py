import numpy as np
import pytest

from splatwire.bitstream import Packetization, PacketPlan, SceneStream, make_packet, make_stream

SYMBOLS_DIGEST = "0123456789abcdef" * 4


def build_stream(
    num_elements: int = 700,
    packetization: Packetization | None = None,
    seed: int = 0,
    payload_bytes: int = 40,
    side_info_bytes: int = 200,
) -> SceneStream:
    packetization = packetization or Packetization(block_size=100, lanes=4)
    plan, rng = PacketPlan(packetization, num_elements), np.random.default_rng(seed)
    return make_stream(
        packetization=packetization,
        num_elements=num_elements,
        feature_dim=50,
        num_offsets=10,
        feature_groups=(10, 10, 10, 10, 10),
        side_info=rng.bytes(side_info_bytes),
        packets=[make_packet(i, plan.count(i), rng.bytes(int(rng.integers(1, payload_bytes)))) for i in plan.ids],
        symbols_digest=SYMBOLS_DIGEST,
        writer="splatwire test",
    )


@pytest.fixture(scope="session")
def stream() -> SceneStream:
    return build_stream()


@pytest.fixture(scope="session")
def make_test_stream():
    return build_stream
