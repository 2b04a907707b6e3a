"""What a stream costs the page is in proportion to its bytes, as it is in Python (`tests/codec/test_memory.py`)."""

import base64
import json
import os
import subprocess
from pathlib import Path

import pytest

from greedy import greedy_clips, greedy_streams
from splatwire.packets import read_stream, stream_from_bytes, write_stream
from web.node import WEB, lacking

GOLDEN = Path(__file__).parents[1] / "golden"


def test_no_small_stream_takes_much_memory_in_the_page(tmp_path: Path) -> None:
    if reason := lacking():
        pytest.skip(reason)
    pinned = json.loads((GOLDEN / "gaussians.json").read_text())["one"]["swz"]
    streams = dict(greedy_streams(stream_from_bytes(base64.b64decode(pinned))[0]))
    streams |= dict(greedy_clips(read_stream(GOLDEN / "tiny_clip.swz")[0]))
    names = {name.replace(" ", "_") + ".swz": stream for name, stream in streams.items() if stream.manifest.schema.page}
    for name, stream in names.items():
        write_stream(stream, tmp_path / name)
    done = subprocess.run(
        ["node", "scripts/test.mjs", "only", "memory"], cwd=WEB, capture_output=True, text=True, timeout=600,
        env={**os.environ, "GREEDY": ":".join(str(tmp_path / name) for name in names)}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    assert "skipped 0" in done.stdout
