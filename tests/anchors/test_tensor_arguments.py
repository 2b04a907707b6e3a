"""Tensors in place of arrays give an error. Runs in a separate process, without this suite's checks of annotations."""

import subprocess
import sys

import pytest

CODE = """
import numpy as np
import torch
from splatwire.errors import InvalidValueError
from splatwire.types.splats import Splats

rows = np.zeros((9, 3), np.float32)
try:
    Splats(torch.zeros(9, 3), np.zeros((9, 4), np.float32), rows, rows[:, 0], rows[:, None])
except InvalidValueError as error:
    print(error)
"""


def test_a_tensor_is_refused_with_the_way_to_an_array() -> None:
    pytest.importorskip("torch")
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert done.stdout == (
        "Splats.means: expected a float32 array (G, 3), not torch.Tensor: `.detach().cpu().float().numpy()` makes one\n"
    )
