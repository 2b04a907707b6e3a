"""Memory and time of a receiver are proportional to the size of the stream; trusted streams may have a higher limit."""

import base64
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from oversized import LARGEST, of_gaussians, oversized_clips, oversized_streams
from splatwire.bitstream import SceneStream, read_stream, stream_from_bytes, write_stream
from splatwire.codec import ProgressiveDecoder, decode_stream, memory
from splatwire.codec.decoding import open_decoder
from splatwire.codec.memory import VARIABLE, allocating, check_memory, threads_within
from splatwire.errors import BitstreamError, InvalidValueError

TESTS = Path(__file__).parents[1]
GOLDEN = TESTS / "golden"
MAX_MB = 400


def real_gaussians() -> bytes:
    pinned = json.loads((GOLDEN / "gaussians.json").read_text())
    return base64.b64decode(pinned["one"]["swz"])


@pytest.fixture(scope="module")
def oversized() -> dict[str, SceneStream]:
    clips = oversized_clips(read_stream(GOLDEN / "tiny_clip.swz")[0])
    return dict([*oversized_streams(stream_from_bytes(real_gaussians())[0]), *clips])


@pytest.mark.slow
@pytest.mark.parametrize(
    "codec", ["gaussians", *(pytest.param(name, marks=pytest.mark.extended) for name in ("causal", "hacpp", "tracks"))]
)
def test_small_streams_allocate_little_memory(oversized: dict[str, SceneStream], codec: str, tmp_path: Path) -> None:
    """Inspects, decodes at once and progressively, writes the received packets and drops lost elements."""
    small = {"causal": "tiny_causal.swz", "hacpp": "tiny.swz", "tracks": "tiny_clip.swz"}
    warm = GOLDEN / small[codec] if codec in small else tmp_path / "warm.swz"
    (tmp_path / "warm.swz").write_bytes(real_gaussians())
    names = [name for name, stream in oversized.items() if stream.manifest.schema_name == codec]
    for n, name in enumerate(names):
        write_stream(oversized[name], tmp_path / f"{n}.swz")
    words = [str(path) for path in (warm, tmp_path, *(tmp_path / f"{n}.swz" for n in range(len(names))))]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    environment.pop(VARIABLE, None)
    command = [sys.executable, str(TESTS / "oversized.py"), *words]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found = dict(zip(names, json.loads(done.stdout), strict=True))
    assert {name: said for name, said in found.items() if max(v for k, v in said.items() if "MB" in k) > MAX_MB} == {}
    refused = [text for said in found.values() for text in said.values() if isinstance(text, str)]
    assert any(VARIABLE in text for text in refused)


@pytest.mark.slow
def test_lost_elements_allocate_memory_only_on_access(oversized: dict[str, SceneStream]) -> None:
    stream = oversized["gaussians announced in 4000 blocks"]
    decoder = ProgressiveDecoder(stream.manifest, stream.side_info)
    assert (decoder.num_received, decoder.complete) == (0, False)
    with pytest.raises(BitstreamError, match=f"would take 6.*{VARIABLE}="):
        decoder.received_scene  # noqa: B018
    anchors = oversized["6400000 wide anchors"]
    with pytest.raises(BitstreamError, match=VARIABLE):
        ProgressiveDecoder(anchors.manifest, anchors.side_info).received_scene  # noqa: B018


def test_environment_variable_raises_the_memory_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = of_gaussians(stream_from_bytes(real_gaussians())[0], LARGEST, 65_535, 0)
    monkeypatch.setattr(memory, "FREE_BYTES", 10_000_000)
    with pytest.raises(BitstreamError) as refused:
        decode_stream(stream)
    word = next(word for word in str(refused.value).split() if word.startswith(VARIABLE))
    monkeypatch.setenv(*word.split("="))
    assert decode_stream(stream).loss_mask.num_lost == 65_535
    monkeypatch.setenv(VARIABLE, "0.001")
    with pytest.raises(BitstreamError, match=r"may take 0\.00 GB"):
        decode_stream(stream)
    for nonsense in ("much", "-1", "nan", "1e9", ""):
        monkeypatch.setenv(VARIABLE, nonsense)
        with pytest.raises(InvalidValueError, match=VARIABLE):
            decode_stream(stream)


@pytest.mark.parametrize("name", ["tiny.swz", "tiny_causal.swz"])
def test_oversized_anchor_streams_are_refused_before_allocation(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, _ = read_stream(GOLDEN / name)
    monkeypatch.setattr(memory, "FREE_BYTES", 0)
    monkeypatch.setattr(memory, "BYTES_PER_BYTE", 0)
    with pytest.raises(BitstreamError, match="anchors"):
        decode_stream(stream)
    with pytest.raises(BitstreamError, match="anchors"):
        ProgressiveDecoder(stream.manifest, stream.side_info)
    monkeypatch.undo()
    decoder = ProgressiveDecoder(stream.manifest, stream.side_info)
    monkeypatch.setattr(memory, "FREE_BYTES", 0)
    monkeypatch.setattr(memory, "BYTES_PER_BYTE", 0)
    with pytest.raises(BitstreamError, match="that arrived"):
        decoder.add(stream.packets)


@pytest.mark.parametrize("name", ["gaussians.swz", "tiny_clip.swz"])
def test_memory_of_a_thread_grows_with_the_largest_packet(name: str) -> None:
    stream = stream_from_bytes(real_gaussians())[0] if name == "gaussians.swz" else read_stream(GOLDEN / name)[0]
    decoder = open_decoder(stream.manifest, stream.side_info, stream.num_bytes)
    packets = [replace(stream.packets[0], data=bytes(size)) for size in (100, 2_000_000, 1_000)]
    assert decoder.working_bytes(packets) - decoder.working_bytes(packets[:1]) == 8 * (2_000_000 - 100)


def test_small_streams_use_few_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "1")
    assert threads_within(100, 200_000_000, None, "x", 16) == 4
    assert threads_within(100, 200_000_000, None, "x", 3) == 3
    assert threads_within(0, 0, None, "x", 5) == 5
    with pytest.raises(BitstreamError, match="x would take 1"):
        threads_within(900_000_000, 200_000_000, None, "x", 3)


def test_memory_allowance_grows_with_the_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    check_memory(memory.FREE_BYTES, 0, "x")
    check_memory(memory.FREE_BYTES + 1000 * memory.BYTES_PER_BYTE, 1000, "x")
    with pytest.raises(BitstreamError, match="1,000 bytes"):
        check_memory(memory.FREE_BYTES + 1000 * memory.BYTES_PER_BYTE + 1, 1000, "x")
    with pytest.raises(BitstreamError, match="a stream may"):
        check_memory(memory.MAX_BYTES + 1, None, "x")


def test_a_failed_allocation_is_an_error_of_the_stream() -> None:
    with pytest.raises(BitstreamError, match="too large takes more memory than"), allocating("too large"):
        np.zeros(1 << 50, np.float32)
    with pytest.raises(BitstreamError), allocating("too large"):
        raise MemoryError
    with pytest.raises(RuntimeError, match="else"), allocating("too large"):
        raise RuntimeError("something else")
