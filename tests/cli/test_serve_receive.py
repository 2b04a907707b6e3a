"""The verbs `serve` and `receive`, with the server in another process."""

import asyncio
import contextlib
import json
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from explicit import encode_splats
from moving_sequences import moving_frames
from processes import server_process
from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import PRESETS, Packetization, read_stream, write_stream
from splatwire.cli import _run_receive
from splatwire.cli._run_receive import parse_seconds
from splatwire.cli.main import main
from splatwire.cli.receive import Receive
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.codec.preview import Preview, PreviewQuantisation, preview_scene, write_preview
from splatwire.concealment import conceal
from splatwire.data import save_cameras
from splatwire.errors import InvalidValueError
from splatwire.io.formats import read_splats, write_splats
from splatwire.lod import encode_levels
from splatwire.types import SplatScene

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
from splatwire.transport import Protection, Receiver, Welcomed
from splatwire.transport.http.server import PageLimits
from splatwire.transport.protocol.handshake import HandshakeAttempt
from splatwire.transport.protocol.wire import DATA, decode, message_kind

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def stream_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("served") / "tiny.swz"
    write_stream(encode_scene(tiny_scene(seed=1, num_anchors=400), PRESETS["datagram"]), path)
    return path


def serving(*words: str) -> contextlib.AbstractContextManager[dict[str, Any]]:
    """Runs a server process and yields its JSON description."""
    return server_process([sys.executable, "-m", "splatwire", "serve", *words, "--port", "0", "--json"])


@pytest.fixture(scope="module")
def url(stream_file: Path) -> Iterator[str]:
    with serving(str(stream_file)) as facts:
        assert list(facts["streams"]) == ["tiny"]
        yield f"udp://127.0.0.1:{facts['port']}"


def call(*words: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(list(words))
    return int(stopped.value.code or 0)


def test_received_stream_equals_the_served_stream(
    url: str, stream_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert call("receive", url, "-o", str(tmp_path / "got.swz"), "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["finished"] == "complete"
    assert facts["packets"]["num_missing"] == 0
    assert (tmp_path / "got.swz").read_bytes() == stream_file.read_bytes()


def test_receive_reports_when_only_the_preview_arrived(
    stream_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
):
    """The server is too slow for any packet, so the preview is written as a scene."""
    frame = PreviewQuantisation.fitting((0.0,) * 3, 1.0, (-0.5, -0.5, -0.5, -2.0), (0.5, 0.5, 0.5, -1.0))
    levels = np.random.default_rng(0).integers(0, 16, (20, 10))
    preview = write_preview(Preview(frame, (0, 51, 102), levels))
    for name, content in (("good.swz", preview), ("bad.swz", preview[:-1])):
        write_stream(with_section(read_stream(stream_file)[0], "preview", content), tmp_path / name)
    with serving(str(tmp_path / "good.swz"), str(tmp_path / "bad.swz"), "--rate", "0.001") as facts:
        url = f"udp://127.0.0.1:{facts['port']}"
        assert call("receive", url, "-o", str(tmp_path / "seen.swz"), "--deadline", "500ms") == 2
        error = capsys.readouterr().err.strip().splitlines()[-1]
        file = tmp_path / "seen.preview.ply"
        assert f"packets arrived); its preview did: 20 Gaussians before 0.000 0.200 0.400 (RGB) -> {file}" in error
        assert "no scene arrived (deadline: of the side information at least " in error
        assert "if the scene is in map coordinates, relative to its origin, which did not arrive" in error
        assert not (tmp_path / "seen.swz").exists()
        expected, there = preview_scene(preview).splats, read_splats(file)
        assert not [record for record in caplog.records if record.name.startswith("splatwire.io")]
        assert np.allclose(there.means, expected.means)
        assert np.allclose(there.scales, expected.scales)
        assert np.allclose(there.sh, expected.sh, atol=1e-6)
        assert call("receive", f"{url}/bad", "-o", str(tmp_path / "b.swz"), "--deadline", "500ms") == 2
        assert "packets arrived), and what should have been its preview: " in capsys.readouterr().err
        assert not (tmp_path / "b.preview.ply").exists()
        assert call("receive", url, "-o", "-", "--deadline", "500ms") == 2
        assert "name a file" in capsys.readouterr().err
    with serving(str(tmp_path / "good.swz")) as facts:
        words = ("receive", f"udp://127.0.0.1:{facts['port']}", "-o", str(tmp_path / "all.swz"), "--json")
        assert call(*words) == 0
        content = json.loads(capsys.readouterr().out)
        assert 0 < content["seconds_to_preview"] <= content["seconds_to_side_info"]
        assert not (tmp_path / "all.preview.ply").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_receive_writes_the_arrived_packets(stream_file: Path, tmp_path: Path, monkeypatch, capsys, number):
    """A signal after the first packet keeps the packets, reports them and sets the exit status."""
    from splatwire.cli._run_receive import TransferTimes
    from splatwire.codec import decode_stream
    from splatwire.transport import PacketArrived

    on_event = TransferTimes.on_event

    def interrupted(self, event, show):
        on_event(self, event, show)
        if isinstance(event, PacketArrived):
            signal.raise_signal(number)

    monkeypatch.setattr(TransferTimes, "on_event", interrupted)
    with serving(str(stream_file), "--rate", "0.3") as facts:
        target = tmp_path / "part.swz"
        assert call("receive", f"udp://127.0.0.1:{facts['port']}", "-o", str(target)) == 128 + number
    output = capsys.readouterr()
    assert "(stopped) -> " in output.out
    assert output.err.strip().splitlines()[-1] == "splatwire: stopped"
    stream, whole = read_stream(target)[0], read_stream(stream_file)[0]
    assert 0 < len(stream.packets) < len(whole.packets)
    assert decode_stream(stream).loss_mask.num_lost > 0


def test_serve_without_a_stream_serves_the_bundled_gaussians():
    from splatwire.bitstream.sections import sections_of
    from splatwire.cli import _bundled, _run_serve
    from splatwire.cli.serve import Serve
    from splatwire.codec.initial_view import SECTION

    stream, _ = read_stream(_bundled.ASSETS / _bundled.SPLATS)
    ((name, program),) = _run_serve._served_streams(Serve(), Protection()).served.items()
    assert (name, program.stream_id) == ("snowmiku_gaussians", stream.manifest.stream_id)
    assert stream.manifest.elements == "Gaussians"
    assert SECTION in sections_of(stream)
    assert program.preview


@pytest.mark.parametrize(
    ("name", "warned"), [("é" * 32, False), ("é" * 32 + "x", True), ("a\u200db", True), ("a\nb\x1b[2J", True)]
)
def test_names_that_no_request_can_contain_are_named(
    stream_file: Path, tmp_path: Path, capsys, name: str, warned: bool
):
    from splatwire.cli import _run_serve
    from splatwire.cli._terminal import one_line
    from splatwire.cli.serve import Serve

    file = tmp_path / f"{name}.swz"
    file.write_bytes(stream_file.read_bytes())
    assert list(_run_serve._served_streams(Serve((str(file),)), Protection()).served) == [name]
    error = capsys.readouterr().err
    assert (f"clients cannot ask for '{one_line(name)}'" in error) == warned
    assert error.count("\n") == warned
    assert error.replace("\n", "").isprintable()


def test_two_streams_of_one_name_are_refused(stream_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    other = tmp_path / stream_file.name
    other.write_bytes(stream_file.read_bytes())
    assert call("serve", str(stream_file), str(other)) == 2
    error = capsys.readouterr().err
    assert "both called 'tiny'" in error
    assert f"{stream_file} and {other}" in error


def test_receive_accepts_a_suffix_in_upper_case(tmp_path: Path):
    write_stream(encode_splats(some_splats(), PRESETS["datagram"]), tmp_path / "splats.swz")
    with serving(str(tmp_path / "splats.swz")) as facts:
        assert call("receive", f"udp://127.0.0.1:{facts['port']}", "-o", str(tmp_path / "a.SPZ")) == 0
    assert read_splats(tmp_path / "a.SPZ").num_gaussians == some_splats().num_gaussians


def test_receive_writes_a_decoded_scene(url: str, tmp_path: Path):
    from splatwire.anchors.scene_file import load_scene

    target = tmp_path / "decoded.scene"
    assert call("receive", f"{url}/tiny", "-o", str(target), "--conceal", "drop", "--deadline", "20s") == 0
    assert load_scene(target).anchors.num_anchors == 400


def test_stream_in_other_packets_is_repacked_to_the_same_scene(tmp_path: Path):
    paper, got = tmp_path / "paper.swz", tmp_path / "got.swz"
    whole = encode_scene(tiny_scene(seed=1, num_anchors=400), Packetization(lanes=1))
    write_stream(whole, paper)
    with serving(str(paper)) as facts:
        assert call("receive", f"udp://127.0.0.1:{facts['port']}", "-o", str(got)) == 0
    received = read_stream(got)[0]
    assert received.manifest.packetization.hashed
    sent, seen = decode_stream(whole).scene.elements, decode_stream(received).scene.elements
    assert all(np.array_equal(values, vars(seen)[name]) for name, values in vars(sent).items())


def test_invalid_options_are_one_error_line(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    paper = tmp_path / "paper.swz"
    write_stream(encode_scene(tiny_scene(seed=1, num_anchors=400), Packetization(lanes=1)), paper)
    for words, message in (
        (("receive", f"{url}/other", "-o", str(tmp_path / "a.swz")), "no such stream"),
        (("receive", "http://x", "-o", str(tmp_path / "a.swz")), "is not an address"),
        (("receive", url, "-o", str(tmp_path / "a.swz"), "--deadline", "soon"), "is not a time"),
        (("serve", str(paper), "--port", "70000"), "a port is a number"),
        (("serve", str(paper), "--protect", "tier9=1"), "is not parity for a tier"),
        (("serve", str(paper), "--protect", "tier0=1", "tier0=1"), "is not parity for a tier"),
        (("serve", str(paper), "--origins", "https://x.org"), "are for --quic"),
        (("serve", str(paper), "--idle", "0"), "--idle is from"),
        (("receive", url, "-o", str(tmp_path / "a.swz"), "--insecure"), "are for quic://"),
        (("serve", str(paper), "--clients-per-address", "0"), "at least 1"),
    ):
        assert call(*words) == 2
        error = capsys.readouterr().err.strip().splitlines()
        assert message in error[-1]
    assert not (tmp_path / "a.swz").exists()


def test_durations_are_parsed():
    assert [parse_seconds(t) for t in ("2s", "500ms", "1.5", ".5 s")] == [2.0, 0.5, 1.5, 0.5]
    for wrong in ("", "s", "-1", "2m", "1e3"):
        with pytest.raises(InvalidValueError):
            parse_seconds(wrong)


def test_a_folder_of_packets_is_served_under_its_name(stream_file: Path, tmp_path: Path):
    from splatwire.cli._files import stream_name
    from splatwire.cli._run_serve import _served_streams
    from splatwire.cli.serve import Serve
    from splatwire.transport import Protection

    folder = tmp_path / "scene"
    write_stream(read_stream(stream_file)[0], folder)
    assert stream_name(str(folder)) == "scene"
    one, other = (_served_streams(Serve((str(path),)), Protection()).served for path in (folder, stream_file))
    assert one["scene"].packets == other["tiny"].packets


def test_serve_and_receive_work_over_quic(stream_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Covers a generated and a given certificate, the fingerprint, the page and the capture."""
    pytest.importorskip("aioquic", reason="the package aioquic is not installed")
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    from splatwire.transport.quic.certificate import self_signed

    with serving(str(stream_file), "--page", "0") as facts:
        url, target = f"quic://127.0.0.1:{facts['port']}/tiny", str(tmp_path / "got.swz")
        capture = tmp_path / "transfer.pcap"
        words = ("--fingerprint", facts["fingerprint"], "--pcap", str(capture), "--json")
        assert call("receive", url, "-o", target, *words) == 0
        assert json.loads(capsys.readouterr().out)["finished"] == "complete"
        assert Path(target).read_bytes() == stream_file.read_bytes()
        assert capture.stat().st_size > stream_file.stat().st_size
        assert call("receive", url, "-o", target) == 2
        assert (
            "self-signed certificate. Trust it with --fingerprint (which the server prints when it starts)"
            in capsys.readouterr().err
        )
        with urlopen(facts["page"], timeout=600) as page:
            content = page.read()
        assert b'<splat-wire src="streams/tiny.swz?' in content
        with urlopen(facts["page"] + "streams/tiny.swz", timeout=600) as file:
            assert sorted(file.read()) == sorted(stream_file.read_bytes()), "the same packets in another order"
        assert b'rel="icon" href="data:,"' in content, "else browsers ask for /favicon.ico, which is not there"
    identity = self_signed()
    certificate, key = tmp_path / "server.pem", tmp_path / "key.pem"
    certificate.write_bytes(identity.certificate.public_bytes(Encoding.PEM))
    key.write_bytes(identity.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    with serving(str(stream_file), "--quic", "--certificate", str(certificate), "--key", str(key)) as facts:
        assert facts["fingerprint"] == identity.fingerprint
        url = f"quic://127.0.0.1:{facts['port']}"
        assert call("receive", url, "-o", target, "--authority", str(certificate)) == 0


def test_serve_ends_despite_slow_readers_and_prints_its_summary_only():
    """Clients include readers that never read, half-open requests and an incomplete page."""
    pytest.importorskip("aioquic", reason="the package aioquic is not installed")
    command = [sys.executable, "-m", "splatwire", "serve", "--page", "0", "--port", "0", "--json"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        (name,), page = (facts := json.loads(server.stdout.readline()))["streams"], urlsplit(facts["page"])
        with contextlib.ExitStack() as stack:
            for request in (f"GET /streams/{name}.swz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", "GET / HTTP/1.1\r\n"):
                for _ in range(50):
                    client = stack.enter_context(socket.create_connection((page.hostname, page.port), timeout=600))
                    client.sendall(request.encode())
                    if request.endswith("\r\n\r\n"):
                        assert client.recv(8) == b"HTTP/1.1"  # the request is being answered
            server.terminate()
            _, summary = server.communicate(timeout=600)
    finally:
        server.kill()
        server.communicate()
    assert server.returncode == 0
    (line,) = summary.splitlines()
    answered = PageLimits().per_network  # the page is busy for other clients
    assert re.fullmatch(rf"served 0 clients, 0 bytes, and {answered} requests over HTTP, [\d,]+ bytes", line)


def test_serve_accepts_parity_per_tier():
    from splatwire.cli._protection import parse_tiers
    from splatwire.cli._run_serve import protection
    from splatwire.cli.serve import Serve
    from splatwire.transport import Protection

    assert parse_tiers(["tier2=0.5", "tier0=1"]) == (1.0, 0.0, 0.5)
    assert protection(Serve(("x.swz",), protect=("tier0=0.4",))) == (Protection(tier_repair=(0.4,)), None)
    assert protection(Serve(("x.swz",), init_repair=0.1)) == (Protection(init_repair=0.1), None)


def test_receive_with_a_camera_gets_only_visible_tiles(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    stream = encode_levels(SplatScene(some_splats(30_000)))  # the packets exceed a datagram
    cameras = tiny_cameras(1, 320, 240)
    poses = cameras.viewmats.copy()
    poses[:, :3, 3] += np.array([0.0, 0.0, 3000.0], np.float32)
    write_stream(stream, tmp_path / "city.swz")
    save_cameras(replace(cameras, viewmats=poses), tmp_path / "cameras.json")
    with serving(str(tmp_path / "city.swz")) as facts:
        url = f"udp://127.0.0.1:{facts['port']}"
        assert call("receive", url, "-o", str(tmp_path / "seen.swz"), "--json",
                    "--camera", str(tmp_path / "cameras.json")) == 0  # fmt: skip
    result = json.loads(capsys.readouterr().out)
    assert result["finished"] == "seen"
    assert 0 < result["packets"]["num_received"] < result["packets"]["num_expected"]
    shown = conceal(decode_stream(read_stream(tmp_path / "seen.swz")[0]), "coarse").drawn()
    assert shown.num_gaussians > 0


@pytest.mark.parametrize(("words", "status"), [((), 3), (("--partial",), 0), (("--deadline", "30s"), 3)])
def test_incomplete_stream_exits_with_an_error(stream_file: Path, tmp_path: Path, capsys, words, status):
    """A relay drops one packet permanently; the received packets are written."""
    target = tmp_path / "part.swz"
    with serving(str(stream_file)) as facts, relay_losing_one(facts["port"]) as port:
        assert call("receive", f"udp://127.0.0.1:{port}", "-o", str(target), "--no-nack", *words) == status
    output = capsys.readouterr()
    assert "(sent) -> " in output.out
    assert ("the stream is incomplete (sent: " in output.err) == (status != 0)
    stream, whole = read_stream(target)[0], read_stream(stream_file)[0]
    assert len(stream.packets) == len(whole.packets) - 1


def let_deadline_pass(monkeypatch: pytest.MonkeyPatch, when: Callable[[Receiver], bool]) -> None:
    """Lets the deadline of receivers pass when a condition is met."""
    original = Receiver.poll

    def poll(receiver: Receiver, now: float) -> Any:
        if when(receiver):
            receiver._began_at = -1e9
        return original(receiver, now)

    monkeypatch.setattr(Receiver, "poll", poll)


@pytest.mark.parametrize(("words", "status"), [((), 3), (("--partial",), 0)])
def test_deadline_that_passes_before_all_arrived_is_no_success(
    stream_file, tmp_path, capsys, monkeypatch, words, status
):
    target, num_packets = tmp_path / "part.swz", len(read_stream(stream_file)[0].packets)

    def lacks_one(receiver: Receiver) -> bool:
        return receiver.collector is not None and receiver.collector.num_packets == num_packets - 1

    let_deadline_pass(monkeypatch, lacks_one)
    with serving(str(stream_file)) as facts, relay_losing_one(facts["port"]) as port:
        url = f"udp://127.0.0.1:{port}"
        assert call("receive", url, "-o", str(target), "--deadline", "600s", "--json", *words) == status
    output = capsys.readouterr()
    assert json.loads(output.out)["finished"] == "deadline"
    assert ("the stream is incomplete (" in output.err) == (status != 0)
    assert len(read_stream(target)[0].packets) == len(read_stream(stream_file)[0].packets) - 1


@pytest.mark.parametrize("scheme", ["udp", "quic"])
def test_waiting_for_a_live_stream_that_has_not_begun_is_reported_once(
    scheme: str, tmp_path: Path, capsys, monkeypatch
):
    """A live server without a frame; the receiver obeys its deadline."""
    refusals, original = list[int](), HandshakeAttempt.on_refusal

    def on_refusal(attempt: HandshakeAttempt, *arguments: Any) -> None:
        refusals.append(attempt.nonce)
        original(attempt, *arguments)

    monkeypatch.setattr(HandshakeAttempt, "on_refusal", on_refusal)
    let_deadline_pass(monkeypatch, lambda receiver: len(refusals) > 3)
    words = ["live", str(tmp_path), "--port", "0", "--json", *(["--quic"] if scheme == "quic" else [])]
    with server_process([sys.executable, "-m", "splatwire", *words]) as facts:
        url = f"{scheme}://127.0.0.1:{facts['port']}"
        trust = ["--insecure"] if scheme == "quic" else []
        assert call("receive", url, "-o", str(tmp_path / "a.swz"), "--deadline", "600s", *trust) == 2
    error = capsys.readouterr().err
    assert error.count("splatwire: warning: the stream has not begun; waiting for its data\n") == 1
    assert "no scene arrived (deadline: the stream has not begun)" in error


def test_standard_output_gets_only_the_last_period_of_a_live_clip(
    stream_file: Path, tmp_path: Path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for number in range(3):
        _run_receive._write_period(Receive("udp://h", "-"), read_stream(stream_file)[0], number)
    assert not list(tmp_path.iterdir())
    error = capsys.readouterr().err
    assert error.count("only the last one goes to standard output: name a .swz file to keep all") == 1
    _run_receive._write_period(Receive("udp://h", "a.swz"), read_stream(stream_file)[0], 1)
    assert [path.name for path in tmp_path.iterdir()] == ["a.001.swz"]


def test_frames_of_a_live_clip_are_not_mixed_with_earlier_ones(tmp_path: Path, monkeypatch, capsys):
    earlier = tmp_path / "clip" / "frame_000007.ply"
    earlier.parent.mkdir()
    earlier.write_bytes(b"ply")
    welcomed = Welcomed(1, 1, is_live=True)
    monkeypatch.setattr(_run_receive, "_transfer", lambda command, address, options, on_event: on_event(welcomed))
    assert call("receive", "udp://h", "-o", str(earlier.parent)) == 2
    assert "clip is there already and not empty: name a new folder" in capsys.readouterr().err
    assert list(earlier.parent.iterdir()) == [earlier]


def test_live_clips_are_received_without_follow(tmp_path: Path, monkeypatch, capsys):
    async def transfer(options, on_event, *, stop) -> Receiver:
        on_event(Welcomed(1, 1, is_live=True))
        return Receiver(1, 0.0)

    monkeypatch.setattr(_run_receive, "transfer_of", lambda trust, address: transfer)
    assert call("receive", "udp://h/live", "-o", str(tmp_path / "a.swz"), "--follow") == 2
    assert "udp://h/live is a live clip: receive it without --follow" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["a.ply", "a.SPZ"])
def test_live_clip_is_not_written_to_a_folder_with_the_name_of_a_file(name: str, tmp_path: Path, capsys):
    frames, target = tmp_path / "frames", tmp_path / name
    frames.mkdir()
    for number, splats in enumerate(moving_frames(100, 4)):
        write_splats([splats], frames / f"{number}.ply")
    words = ["live", str(frames), "--port", "0", "--json", "--group", "2"]
    with server_process([sys.executable, "-m", "splatwire", *words]) as facts:
        assert call("receive", f"udp://127.0.0.1:{facts['port']}", "-o", str(target)) == 2
    assert "is a live clip, whose frames" in capsys.readouterr().err
    assert not target.exists()


@pytest.mark.parametrize(
    ("reason", "live", "missed", "complete"),
    [
        ("complete", False, 0, True),
        ("complete", True, 3, False),  # of a chapter that has ended
        ("seen", False, 0, True),
        ("sent", True, 0, True),
        ("sent", True, 1, False),
        ("sent", False, 0, False),
        ("deadline", False, 0, False),
        ("deadline", True, 0, False),
        ("stopped", False, 0, False),
        ("the server fell silent", True, 0, False),
    ],
)
def test_only_listed_end_reasons_count_as_complete(reason, live, missed, complete):
    assert _run_receive._is_complete(reason, live=live, num_missed=missed) is complete


@contextlib.contextmanager
def relay_losing_one(server_port: int) -> Iterator[int]:
    """A relay that drops every copy of the last packet of its first pass."""
    ready, ports, loops = threading.Event(), [], []

    async def relay() -> None:
        front, loop = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), asyncio.get_running_loop()
        front.bind(("127.0.0.1", 0))
        back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        back.connect(("127.0.0.1", server_port))
        clients, lost = [], []

        def up() -> None:
            data, address = front.recvfrom(2048)
            clients[:] = [address]
            back.send(data)

        def down() -> None:
            data = back.recv(2048)
            if message_kind(data) == DATA:
                place = decode(data).packet_index
                lost[:] = lost or [place]
                if place == lost[0]:
                    return
            front.sendto(data, clients[0])

        loop.add_reader(front, up)
        loop.add_reader(back, down)
        ports.append(front.getsockname()[1])
        stop = asyncio.Event()
        loops.append((loop, stop))
        ready.set()
        await stop.wait()
        front.close()
        back.close()

    thread = threading.Thread(target=lambda: asyncio.run(relay()), daemon=True)
    thread.start()
    assert ready.wait(120)
    try:
        yield ports[0]
    finally:
        loop, stop = loops[0]
        loop.call_soon_threadsafe(stop.set)
        thread.join(120)


def test_monitored_server_reports_its_transfers_in_metrics_and_log(stream_file: Path, tmp_path: Path):
    pytest.importorskip("prometheus_client", reason="the package prometheus-client is not installed")
    words = (str(stream_file), "--port", "0", "--json", "--monitor", "0", "--log-level", "info", "--log-format", "json")
    with (tmp_path / "log").open("wb") as log:
        server = subprocess.Popen(
            [sys.executable, "-m", "splatwire", "serve", *words], stdout=subprocess.PIPE, stderr=log, text=True
        )
        try:
            facts = json.loads(server.stdout.readline())
            assert urlopen(f"{facts['monitor']}readyz", timeout=600).read() == b"ready\n"
            assert call("receive", f"udp://127.0.0.1:{facts['port']}", "-o", str(tmp_path / "got.swz")) == 0
            metrics = urlopen(f"{facts['monitor']}metrics", timeout=600).read().decode()
        finally:
            server.terminate()
            server.communicate(timeout=600)
    assert "splatwire_transfers_started_total 1.0" in metrics.splitlines()
    events = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert [event["event"] for event in events] == ["transfer started", "transfer ended", "stopped"]
    assert events[2]["transfers"] == 1


@pytest.mark.parametrize("text", ["x", "1:2:x", "65536", "http://127.0.0.1:80", "-1"])
def test_invalid_monitoring_address_is_refused(text: str, capsys: pytest.CaptureFixture[str]):
    assert call("serve", f"--monitor={text}") == 2
    assert "--monitor takes PORT or HOST:PORT" in capsys.readouterr().err


@pytest.mark.parametrize("words", [(), ("--follow",)], ids=["once", "following"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_reception_that_is_stopped_before_a_scene_arrives_fails(tmp_path: Path, monkeypatch, capsys, words, number):
    """A script must not take an old output for the scene."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        silent.settimeout(120)

        def stop() -> None:
            silent.recv(2048)
            signal.raise_signal(number)

        waiting = threading.Thread(target=stop)
        waiting.start()
        url = f"udp://127.0.0.1:{silent.getsockname()[1]}/room"
        assert call("receive", url, "-o", str(tmp_path / "a.swz"), *words) == 128 + number
        waiting.join()
    assert not list(tmp_path.iterdir())
    error = capsys.readouterr().err
    assert error.endswith("splatwire: stopped\n")
    assert ("no scene arrived (stopped)" in error) == (not words)


def test_signals_have_their_handlers_again_after_a_transfer():
    """With the system's default action, SIGTERM would leave temporary files of the output that is then written."""
    from splatwire.cli._receiving import canceling_on_signals

    def own(number: int, frame: object) -> None:
        raise AssertionError("a signal during the transfer only stops it")

    async def work() -> None:
        stop = asyncio.get_running_loop().create_future()
        with canceling_on_signals(stop) as received:
            signal.raise_signal(signal.SIGTERM)
            await asyncio.wait([stop], timeout=600)
        assert (received, stop.cancelled()) == ([signal.SIGTERM], True)

    outside = signal.signal(signal.SIGTERM, own)
    try:
        asyncio.run(work())
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGTERM, outside)


def test_a_repeated_signal_does_not_end_the_writing_of_a_stopped_transfer():
    """`timeout` sends each signal twice."""

    async def transfer(stop: asyncio.Future[None]) -> Receiver:
        signal.raise_signal(signal.SIGINT)
        await asyncio.wait([stop], timeout=600)
        asyncio.get_running_loop().call_soon(signal.raise_signal, signal.SIGINT)
        return Receiver(1, 0.0)

    _, signals = asyncio.run(_run_receive._stoppable(transfer))
    assert signals == [signal.SIGINT] * 2


def test_transfer_ends_if_a_handler_before_it_was_not_pythons(monkeypatch):
    from splatwire.cli._receiving import canceling_on_signals

    async def work() -> None:
        with canceling_on_signals(asyncio.get_running_loop().create_future()) as received:
            assert not received

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with monkeypatch.context() as patch:
            patch.setattr(signal, "getsignal", lambda _: None)
            asyncio.run(work())
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_following_that_ends_without_a_scene_and_without_a_signal_fails(tmp_path: Path, monkeypatch, capsys):
    async def follow(*_: object):
        for stream in ():
            yield stream

    monkeypatch.setattr(_run_receive, "_decoding_module", lambda: SimpleNamespace(follow=follow))
    url = "udp://127.0.0.1:9/room"
    assert call("receive", url, "-o", str(tmp_path / "a.swz"), "--follow") == 128 + signal.SIGINT
    assert capsys.readouterr().err == "splatwire: stopped\n"
