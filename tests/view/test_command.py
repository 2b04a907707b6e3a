"""`splatwire view` as a person starts and ends it."""

import json
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from scenes import tiny_scene
from splatwire.cli.main import main
from splatwire.codec import encode_scene
from splatwire.packets import write_stream

pytest.importorskip("viser", reason="the viewer's extra is not installed")


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
            assert told["anchors"] == 200
            assert not told["live"]
            assert "grow" in told["concealers"]
            assert "sketch" not in told["concealers"]  # this stream carries none
            with urllib.request.urlopen(told["url"], timeout=20) as page:
                assert b"<html" in page.read().lower()
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
        (str(stream), "--conceal", "magic"): "unknown concealer",
        (str(stream), "--loss", "1.5"): "--loss",
        (str(stream), "--height", "2"): "--height",
        (str(stream), "--renderer", "magic"): "unknown renderer",
        (str(stream), "--seed", "-1"): "--seed",
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
        assert f":{port}" in complaint(capsys, str(stream), "--port", str(port))
        assert time.monotonic() - began < 60


def test_without_the_extra_it_says_how_to_get_it(capsys, monkeypatch, stream):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install 'splatwire[view]'" in complaint(capsys, str(stream))
