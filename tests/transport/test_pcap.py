"""Captures are readable by independent programs."""

import asyncio
import io
import shutil
import subprocess
from pathlib import Path

import pytest

from splatwire.transport import ReceiverOptions, make_served_stream
from splatwire.transport.address import Address
from splatwire.transport.pcap import Capture, checksum, ip_datagram
from splatwire.transport.udp import UdpServer, receive_udp
from transport.network import datagram_stream

STREAM = datagram_stream(num_anchors=500, side_bytes=3000)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[tuple[int, int, bytes]]]:
    """Capture of a real transfer, with its ports and content."""
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")
    path, datagrams = tmp_path_factory.mktemp("capture") / "transfer.pcap", []

    async def work() -> None:
        server = UdpServer({"s": make_served_stream(STREAM)}, "127.0.0.1", 0)
        try:
            with path.open("wb") as file:
                writer = Capture(file.write)

                def tap(source: tuple[str, int], target: tuple[str, int], data: bytes) -> None:
                    writer.add(source, target, data, 1_700_000_000.25 + len(datagrams))
                    datagrams.append((source[1], target[1], data))

                receiver = await receive_udp(Address("127.0.0.1", server.port), ReceiverOptions(), None, tap)
            assert receiver.stream() == STREAM
            assert writer.num_datagrams == len(datagrams) > 20
        finally:
            server.close()

    asyncio.run(asyncio.wait_for(work(), 240))
    return path, datagrams


def test_independent_reader_finds_the_same_datagrams(capture):
    dpkt = pytest.importorskip("dpkt", reason="the package dpkt is not installed")
    path, datagrams = capture
    with path.open("rb") as file:
        reader = dpkt.pcap.Reader(file)
        assert reader.datalink() == 101
        records = list(reader)
    assert len(records) == len(datagrams)
    for n, ((seconds, data), (source, target, payload)) in enumerate(zip(records, datagrams, strict=True)):
        packet = dpkt.ip.IP(data)
        assert float(seconds) == pytest.approx(1_700_000_000.25 + n)
        assert (packet.data.sport, packet.data.dport, packet.data.data) == (source, target, payload)
        written = packet.sum, packet.data.sum
        packet.sum = packet.data.sum = 0  # dpkt computes both if zero
        again = dpkt.ip.IP(bytes(packet))
        assert (again.sum, again.data.sum) == written


@pytest.mark.parametrize("tool", ["tcpdump", "tshark"])
def test_public_tools_read_the_capture(capture, tool):
    if shutil.which(tool) is None:
        pytest.skip(f"{tool} is not installed")
    path, datagrams = capture
    words = {"tcpdump": ["-nvvr", str(path)], "tshark": ["-r", str(path), "-o", "udp.check_checksum:TRUE", "-V"]}[tool]
    read = subprocess.run([tool, *words], capture_output=True, text=True, timeout=600, check=True).stdout
    found = {"tcpdump": "udp sum ok", "tshark": "Checksum Status: Good"}[tool]
    assert read.count(found) >= len(datagrams)
    assert "bad udp" not in read
    assert "Malformed" not in read


def test_ipv6_and_mapped_addresses_are_written():
    dpkt = pytest.importorskip("dpkt", reason="the package dpkt is not installed")
    data = ip_datagram(("fe80::1%eth0", 5), ("2001:db8::2", 6), b"odd")
    packet = dpkt.ip6.IP6(data)
    assert (packet.plen, packet.nxt, packet.data.sport, packet.data.data) == (11, 17, 5, b"odd")
    pseudo = data[8:40] + (11).to_bytes(4, "big") + (17).to_bytes(4, "big")
    assert checksum(pseudo + data[40:]) == 0, "sums with their own checksum are all ones"
    assert ip_datagram(("::ffff:1.2.3.4", 5), ("5.6.7.8", 6), b"x")[0] >> 4 == 4
    assert ip_datagram(("::ffff:1.2.3.4", 5), ("::1", 6), b"x")[0] >> 4 == 6


def test_checksums_follow_rfc_1071_and_empty_captures_are_valid():
    assert checksum(bytes.fromhex("0001f203f4f5f6f7")) == 0xFFFF - 0xDDF2
    assert checksum(b"") == checksum(bytes(8)) == 0xFFFF
    assert checksum(b"\xff\xff") == 0
    file = io.BytesIO()
    Capture(file.write)
    assert file.getvalue().hex() == "d4c3b2a1020004000000000000000000ffff000065000000"
