"""Transfer of the bundled scene from `serve` through a lossy relay to `receive`, rendered and scored.

Three processes with real sockets: 20 % loss, a delay of 10 to 15 ms each way with reordering, 2 % duplicates. It
replaces netem on kernels without it.
"""

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import splatwire
from splatwire.bitstream import PRESETS, read_stream, write_stream
from splatwire.codec import decode_stream, encode_scene
from splatwire.concealment import conceal, create_concealer
from splatwire.data import load_cameras
from splatwire.metrics import psnr
from splatwire.render import render_scene

pytestmark = pytest.mark.slow

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
ASSETS = Path(splatwire.__file__).parent / "assets"
RELAY = Path(__file__).parent / "relay.py"
PATH = ("--delay", "0.01", "--jitter", "0.5", "--duplicate", "0.02", "--seed", "3")


@contextlib.contextmanager
def process(*words: str) -> Iterator[str]:
    """Starts a process and yields the first line of its output."""
    started = subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert started.stdout is not None
    try:
        yield started.stdout.readline()
    finally:
        started.terminate()
        started.wait(120)
        started.stdout.close()


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("crossing") / "snowmiku.swz"
    write_stream(encode_scene(decode_stream(read_stream(ASSETS / "snowmiku.swz")[0]).scene, PRESETS["datagram"]), path)
    return path


def crossed(stream: Path, target: Path, *, quic: bool, burst: int, words: tuple[str, ...]) -> dict[str, Any]:
    """Output of `splatwire receive` for a stream through the relay."""
    scheme = "quic" if quic else "udp"
    with process("-m", "splatwire", "serve", str(stream), "--port", "0", "--json", *["--quic"] * quic) as said:
        facts = json.loads(said)
        with process(str(RELAY), "--server", str(facts["port"]), "--burst", str(burst), *PATH) as port:
            command = ["receive", f"{scheme}://127.0.0.1:{port.strip()}", "-o", str(target), "--json", *words]
            pinned = ["--fingerprint", facts["fingerprint"]] if quic else []
            done = subprocess.run(
                [sys.executable, "-m", "splatwire", *command, *pinned], capture_output=True, text=True, timeout=600,
                check=False,
            )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(("quic", "burst"), [(False, 2), (True, 1)])
def test_bundled_scene_is_transferred_and_rendered(served: Path, tmp_path: Path, quic: bool, burst: int):
    """Without retransmission a fifth is missing, and concealment improves the picture.

    Bursts have at most two packets, because bursts of 20 could remove half of 330 packets.
    """
    target = tmp_path / "seen.swz"
    facts = crossed(served, target, quic=quic, burst=burst, words=("--no-nack", "--partial"))
    assert facts["finished"] == "sent"
    assert 0.05 < facts["packets"]["num_missing"] / facts["packets"]["num_expected"] < 0.45
    cameras = load_cameras(ASSETS / "snowmiku_cameras.json").select([0]).scaled(0.5)
    truth = render_scene(decode_stream(read_stream(served)[0]).scene, cameras)
    received = decode_stream(read_stream(target)[0])
    scores = {}
    for name in ("drop", "grow"):
        picture = render_scene(conceal(received, create_concealer(name)), cameras)
        scores[name] = float(psnr(picture, truth).mean())
    assert scores["drop"] > 20
    assert scores["grow"] > scores["drop"]


def test_retransmission_delivers_every_byte(served: Path, tmp_path: Path):
    facts = crossed(served, tmp_path / "seen.swz", quic=False, burst=20, words=())
    assert facts["finished"] == "complete"
    assert (tmp_path / "seen.swz").read_bytes() == served.read_bytes()
