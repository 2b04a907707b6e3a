"""Start and end of `splatwire view`."""

import json
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from scenes import tiny_cameras, tiny_causal_scene
from splatwire.bitstream import CAUSAL, stream_from_bytes, write_stream
from splatwire.cli.main import main
from splatwire.codec import encode_scene
from splatwire.view import page_of_stream

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def stream(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("view") / "tiny.swz"
    write_stream(encode_scene(tiny_causal_scene(num_anchors=200)), path)
    return path


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_view_serves_a_page_until_a_signal(stream, how):
    command = [sys.executable, "-m", "splatwire", "view", str(stream), "--port", "0", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            ready = json.loads(process.stdout.readline())
            with urllib.request.urlopen(ready["url"], timeout=600) as answer:
                assert "<splat-wire" in answer.read().decode()
            with urllib.request.urlopen(ready["url"] + "streams/tiny.swz", timeout=600) as answer:
                assert stream_from_bytes(answer.read())[0].manifest.schema_name == CAUSAL
            process.send_signal(how)
            rest, problems = process.communicate(timeout=600)
        finally:
            process.kill()
    assert process.returncode == 0, problems
    assert rest == ""  # exactly one JSON object
    assert "Traceback" not in problems


def complaint(capsys, *arguments: str) -> str:
    with pytest.raises(SystemExit) as over:
        main(["view", *arguments])
    assert over.value.code == 2
    return capsys.readouterr().err


def test_invalid_options_are_one_error_line(capsys, tmp_path, stream):
    (tmp_path / "notes.swz").write_text("hello")
    cases = {
        (str(tmp_path / "absent.swz"),): "no such file",
        (str(tmp_path / "notes.swz"),): "not a splatwire stream",
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


def test_occupied_port_is_refused(capsys, stream):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"port {port}" in complaint(capsys, str(stream), "--port", str(port))


def test_losses_and_cameras_are_passed_to_the_page():
    stream = encode_scene(tiny_causal_scene(num_anchors=200))
    content = page_of_stream("tiny", stream.with_packets(stream.packets[1:]), tiny_cameras(), "127.0.0.1")
    page, file = (
        content.respond_now(f"GET {target} HTTP/1.1\r\nHost: localhost".encode()).body
        for target in ("/", "/streams/tiny.swz")
    )
    assert [packet.id for packet in stream_from_bytes(file)[0].packets] == [packet.id for packet in stream.packets[1:]]
    begin = page.decode().partition('viewpoint="')[2].partition('"')[0].split()
    assert [float(value) for value in begin[:3]] == pytest.approx(tiny_cameras().centers[0].tolist(), abs=1e-4)
