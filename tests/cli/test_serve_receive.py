"""The verbs `serve` and `receive`: a server process, and clients in this one."""

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from scenes import tiny_scene
from splatwire.cli.main import main
from splatwire.cli.receive import parse_seconds
from splatwire.codec import encode_scene
from splatwire.errors import InvalidValueError
from splatwire.packets import PRESETS, Packetization, read_stream, write_stream

pytest.importorskip("raptorq", reason="the package raptorq is not installed")


@pytest.fixture(scope="module")
def stream_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("served") / "tiny.swz"
    write_stream(encode_scene(tiny_scene(seed=1, num_anchors=400), PRESETS["datagram"]), path)
    return path


@pytest.fixture(scope="module")
def url(stream_file: Path) -> Iterator[str]:
    command = [sys.executable, "-m", "splatwire", "serve", str(stream_file), "--port", "0", "--json"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert server.stdout is not None
    try:
        facts = json.loads(server.stdout.readline())
        assert list(facts["streams"]) == ["tiny"]
        yield f"udp://127.0.0.1:{facts['port']}"
    finally:
        server.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            server.wait(10)
        if server.poll() is None:
            server.kill()
            server.wait(10)
        server.stdout.close()
    assert server.returncode == 0


def call(*words: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(list(words))
    return int(stopped.value.code or 0)


def test_a_stream_arrives_as_it_was(url: str, stream_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert call("receive", url, "-o", str(tmp_path / "got.swz"), "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["finished"] == "complete"
    assert facts["packets"]["num_missing"] == 0
    assert (tmp_path / "got.swz").read_bytes() == stream_file.read_bytes()


def test_a_scene_is_written_on_the_spot(url: str, tmp_path: Path):
    from splatwire.model.scene_file import load_scene

    target = tmp_path / "scene.splat"
    assert call("receive", f"{url}/tiny", "-o", str(target), "--conceal", "drop", "--deadline", "20s") == 0
    assert load_scene(target).anchors.num_anchors == 400


def test_mistakes_are_told_in_one_line(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    paper = tmp_path / "paper.swz"
    write_stream(encode_scene(tiny_scene(seed=1, num_anchors=400), Packetization(lanes=1)), paper)
    for words, told in (
        (("receive", f"{url}/other", "-o", str(tmp_path / "a.swz")), "no such stream"),
        (("receive", "http://x", "-o", str(tmp_path / "a.swz")), "is not an address"),
        (("receive", url, "-o", str(tmp_path / "a.swz"), "--deadline", "soon"), "is not a time"),
        (("serve", str(paper)), "--preset datagram"),
        (("serve", str(paper), "--port", "70000"), "a port is a number"),
        (("serve", str(paper), "--parity", "much"), "is not a tier of parity"),
    ):
        assert call(*words) == 2
        error = capsys.readouterr().err.strip().splitlines()
        assert told in error[-1]
    assert not (tmp_path / "a.swz").exists()


def test_times():
    assert [parse_seconds(t) for t in ("2s", "500ms", "1.5", ".5 s")] == [2.0, 0.5, 1.5, 0.5]
    for wrong in ("", "s", "-1", "2m", "1e3"):
        with pytest.raises(InvalidValueError):
            parse_seconds(wrong)


def test_a_folder_of_packets_is_served_under_its_name(stream_file: Path, tmp_path: Path):
    from splatwire.cli.serve import load_program, stream_name
    from splatwire.transport import Protection

    folder = tmp_path / "scene"
    write_stream(read_stream(stream_file)[0], folder)
    assert stream_name(str(folder)) == "scene"
    assert load_program(str(folder), Protection()).packets == load_program(str(stream_file), Protection()).packets
