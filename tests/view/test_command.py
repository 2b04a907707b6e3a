"""`splatwire view` as a person starts and ends it."""

import json
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path

import pytest
import torch

from scenes import tiny_cameras, tiny_scene
from splatwire.cli.main import main
from splatwire.codec import encode_scene
from splatwire.model import SplatScene
from splatwire.packets import write_stream
from splatwire.scene.splats import Splats


@pytest.fixture(scope="module")
def stream(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("view") / "tiny.swz"
    write_stream(encode_scene(tiny_scene(num_anchors=200)), path)
    return path


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_a_page_until_it_is_told_to_stop(stream, how):
    command = [sys.executable, "-m", "splatwire", "view", str(stream), "--port", "0", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            told = json.loads(process.stdout.readline())
            assert told["drawn_by"] == "server"
            with urllib.request.urlopen(told["url"], timeout=20) as answer:
                page = answer.read().decode()
            assert 'pictures="/picture"' in page
            offered = page.partition('concealers="')[2].partition('"')[0].split()
            assert "grow" in offered
            assert "sketch" not in offered  # this stream carries none
            process.send_signal(how)
            rest, problems = process.communicate(timeout=30)
        finally:
            process.kill()
    assert process.returncode == 0, problems
    assert rest == ""  # one JSON object and nothing else
    assert "Traceback" not in problems
    assert "drawing a picture" in problems  # so nothing is left to be compiled when somebody looks


def complaint(capsys, *arguments: str) -> str:
    with pytest.raises(SystemExit) as over:
        main(["view", *arguments])
    assert over.value.code == 2
    return capsys.readouterr().err


def test_mistakes_are_one_line(capsys, tmp_path, stream):
    (tmp_path / "notes.swz").write_text("hello")
    cases = {
        (str(tmp_path / "absent.swz"),): "no such file",
        (str(tmp_path / "notes.swz"),): "not a splatwire stream",
        (str(stream), "--renderer", "magic"): "unknown renderer",
        (str(stream), "--port", "70000"): "65535",
        (str(stream), "--host", "203.0.113.7"): "cannot listen",
        (str(stream), "--cameras", str(tmp_path / "absent.json")): "absent.json",
        ("tcp://localhost",): "not an address",
        ("udp://localhost", "--insecure"): "quic",
    }
    for arguments, words in cases.items():
        text = complaint(capsys, *arguments)
        assert words in text.splitlines()[-1], (arguments, text)
        assert text.splitlines()[-1].startswith("splatwire: error:")


def test_a_port_that_is_taken_is_not_changed_silently(capsys, stream):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        began = time.monotonic()
        assert f"port {port}" in complaint(capsys, str(stream), "--port", str(port))
        assert time.monotonic() - began < 60


def test_what_browsers_draw_is_given_to_them(tmp_path):
    from splatwire.cli.view import View
    from splatwire.packets import stream_from_bytes
    from splatwire.transport.page_content import PageContent

    rng = torch.Generator().manual_seed(0)
    quats = torch.nn.functional.normalize(torch.randn(300, 4, generator=rng), dim=1)
    scales, opacities = torch.full((300, 3), 0.05), torch.full((300,), 0.5)
    splats = Splats(torch.randn(300, 3, generator=rng), quats, scales, opacities, torch.zeros(300, 1, 3))
    stream = encode_scene(SplatScene(splats))
    write_stream(stream.with_packets(stream.packets[1:]), tmp_path / "gaps.swz")
    with ExitStack() as stack:
        content = View(str(tmp_path / "gaps.swz"))._content(tiny_cameras(), stack)
    assert isinstance(content, PageContent)
    assert content.pictures is None
    page, file = (
        content.answer(f"GET {target} HTTP/1.1\r\nHost: localhost".encode()).partition(b"\r\n\r\n")[2]
        for target in ("/", "/streams/scene.swz")
    )
    assert sorted(packet.payload for packet in stream_from_bytes(file)[0].packets) == sorted(
        packet.payload for packet in stream.packets[1:]
    )
    begin = page.decode().partition('viewpoint="')[2].partition('"')[0].split()
    assert [float(value) for value in begin[:3]] == pytest.approx(tiny_cameras().centers[0].tolist(), abs=1e-4)
