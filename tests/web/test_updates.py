"""Updates of Python in the page's code, run by node."""

import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.gaussians.test_gaussians import DATAGRAM, SMALL, some_splats
from codec.update.test_chain import edits
from codec.update.test_updates import BALL
from explicit import encode_splats
from splatwire.bitstream import write_stream
from splatwire.codec import apply_update
from splatwire.codec.update.removed import write_removed
from web.node import WEB, lacking

pytestmark = pytest.mark.slow
CASES = os.environ.get("SPLATWIRE_FUZZ_CASES", "100")


@pytest.mark.parametrize("packetization", [SMALL, DATAGRAM])
@pytest.mark.parametrize("degree", [0, 2])
def test_pages_apply_updates_as_python_does(tmp_path: Path, packetization, degree: int) -> None:
    if reason := lacking():
        pytest.skip(reason)
    splats = some_splats(degree=degree)
    splats.means[BALL[:9]] = splats.means[BALL[0]]  # in one cell of the curve that sorts Gaussians
    states = [encode_splats(splats, packetization)]
    updates = edits(states[0], splats)
    for update in updates:
        states.append(apply_update(states[-1], update))
    rng = np.random.default_rng(0)
    masks = [rng.random(count) < share for count, share in ((1, 1), (300, 0), (500, 0.1), (5000, 0.5), (256, 1))]
    masks.append(np.repeat(rng.random(40) < 0.3, 100))
    paths: dict[str, Any] = {}
    for kind, streams in (("states", states), ("updates", updates)):
        paths[kind] = [str(tmp_path / f"{kind}{n}.swz") for n in range(len(streams))]
        for path, stream in zip(paths[kind], streams, strict=True):
            write_stream(stream, Path(path))
    paths["larger"] = str(tmp_path / "larger.swz")
    larger = replace(splats, means=splats.means * np.float32(4), scales=splats.scales * np.float32(4))
    write_stream(encode_splats(larger, packetization), Path(paths["larger"]))
    listed = [{"bytes": write_removed(mask).hex(), "count": len(mask), "mask": mask.astype(int).tolist()}
              for mask in masks]  # fmt: skip
    (tmp_path / "chain.json").write_text(json.dumps({**paths, "masks": listed}))
    done = subprocess.run(
        ["node", "scripts/test.mjs", "only", "updates"], cwd=WEB, capture_output=True, text=True, timeout=600,
        env={**os.environ, "UPDATES": str(tmp_path / "chain.json"), "CASES": CASES}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    assert "skipped 0" in done.stdout
