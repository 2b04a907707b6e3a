"""Compiled and cached kernels compute the same bits.

With fast-math they may differ. The first process runs a separately compiled helper, the second one a copy inside its
caller, and the two round differently.
"""

import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numba
import pytest

from splatwire.neural.training import _grid_kernels, _loss_kernels
from splatwire.ops import adam

SCRIPT = """
import hashlib
import numpy as np
from splatwire.ops.adam import update

rng = np.random.default_rng(3)
value, first, second = rng.random(50_001, np.float32), np.zeros(50_001, np.float32), np.zeros(50_001, np.float32)
for step in range(1, 4):
    gradient = rng.random(50_001, np.float32) - np.float32(0.5)
    update(value, gradient, first, second, 1e-3 / (1 - 0.9**step), (1 - 0.999**step) ** 0.5, 0.9, 0.999, 1e-15)
print([hashlib.sha256(part.tobytes()).hexdigest()[:12] for part in (value, first, second)])
"""
"""Adam stands for all kernels of the training, which take long to compile."""


@pytest.mark.slow
def test_compiled_kernels_are_bit_identical(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    answers = [
        subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, timeout=300)
        for _ in range(2)
    ]
    assert [answer.stderr for answer in answers] == ["", ""]
    assert answers[0].stdout == answers[1].stdout
    assert any(tmp_path.rglob("*.nbc")), "nothing was compiled"


@pytest.mark.parametrize("module", [_grid_kernels, _loss_kernels, adam], ids=lambda module: module.__name__)
def test_no_kernel_of_the_training_has_fast_math(module: ModuleType) -> None:
    kernels = {
        name: value for name, value in vars(module).items() if isinstance(value, numba.core.registry.CPUDispatcher)
    }
    assert len(kernels) > 1
    assert [name for name, kernel in kernels.items() if kernel.targetoptions.get("fastmath")] == []
