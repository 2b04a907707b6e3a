"""Compiled and cached kernels compute the same bits.

With fast-math they may differ. The first process runs a separately compiled helper, the second one a copy inside its
caller, and the two round differently.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

SCRIPT = """
import hashlib
import numpy as np
import torch
from splatwire.neural.training._grid_kernels import interpolate, scatter
from splatwire.neural.training.adam import adam_update
from splatwire.neural.training.losses import photometric_loss, prepare_photo
from splatwire.neural.training.state import Moments

torch.set_num_threads(1)
draw = torch.Generator().manual_seed(3)
photo, image = (torch.rand(37, 53, 3, generator=draw) for _ in range(2))
image.requires_grad_()
loss, error = photometric_loss(image, prepare_photo(photo), 0.2)
loss.backward()
value, moments = torch.rand(50_001, generator=draw), Moments(torch.zeros(50_001), torch.zeros(50_001))
for _ in range(3):
    adam_update([(value, torch.rand(50_001, generator=draw) - 0.5, moments, 1e-3)])
rng = np.random.default_rng(3)
table, index = rng.random((320, 4), dtype=np.float32), np.arange(90)
rows = [rng.integers(0, 64, (levels, 90, corners)).astype(np.int32) for levels, corners in ((3, 8), (2, 4))]
for level in range(5):  # each level has rows of its own, as in a hash grid: levels are summed side by side
    rows[level // 3][level % 3] += 64 * level
weights = [rng.random(r.shape, dtype=np.float32) for r in rows]
out, gradient = np.zeros((90, 20), np.float32), np.zeros_like(table)
interpolate(table, rows[0], weights[0], rows[1], weights[1], index, out)
scatter(out, rows[0], weights[0], rows[1], weights[1], index, gradient)
found = [loss.detach().numpy(), error.numpy(), image.grad.numpy(), value.numpy(), out, gradient]
print([hashlib.sha256(part.tobytes()).hexdigest()[:12] for part in found])
"""


def test_compiled_kernels_are_bit_identical(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    answers = [
        subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, timeout=300)
        for _ in range(2)
    ]
    assert [answer.stderr for answer in answers] == ["", ""]
    assert answers[0].stdout == answers[1].stdout
    assert any(tmp_path.rglob("*.nbc")), "nothing was compiled"
