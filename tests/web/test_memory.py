"""Memory of the page is proportional to the bytes of a stream, as in Python (`tests/codec/test_memory.py`)."""

import base64
import json
import os
import subprocess
from pathlib import Path

import pytest

from moving_sequences import moving_frames
from oversized import oversized_clips, oversized_streams
from splatwire.bitstream import read_stream, stream_from_bytes, write_stream
from splatwire.sequence import SequenceOptions, encode_sequence
from web.installed import called
from web.node import WEB, lacking

pytestmark = pytest.mark.slow

GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.mark.extended
def test_small_streams_allocate_little_memory_in_the_page(tmp_path: Path) -> None:
    if reason := lacking():
        pytest.skip(reason)
    pinned = json.loads((GOLDEN / "gaussians.json").read_text())["one"]["swz"]
    streams = dict(oversized_streams(stream_from_bytes(base64.b64decode(pinned))[0]))
    streams |= dict(oversized_clips(read_stream(GOLDEN / "tiny_clip.swz")[0]))
    names = {name.replace(" ", "_") + ".swz": stream for name, stream in streams.items() if stream.manifest.schema.page}
    for name, stream in names.items():
        write_stream(stream, tmp_path / name)
    done = subprocess.run(
        ["node", "scripts/test.mjs", "only", "memory"], cwd=WEB, capture_output=True, text=True, timeout=1200,
        env={**os.environ, "GREEDY": ":".join(str(tmp_path / name) for name in names)}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    assert "skipped 0" in done.stdout


def test_page_decodes_a_clip_of_many_tracks_in_few_bytes(tmp_path: Path) -> None:
    """The motion of the group takes 107 MB. Pages allow 157 MB and 160 bytes per received byte."""
    if reason := lacking():
        pytest.skip(reason)
    options = SequenceOptions(group_frames=64, quality="small", order="tracked")
    stream, _ = encode_sequence(moving_frames(16_000, 64), options)
    write_stream(stream, tmp_path / "clip.swz")
    assert stream.num_bytes < 300_000
    assert json.loads(called(["node", "scripts/time.mjs", str(tmp_path / "clip.swz")], WEB))["ms"] > 0
