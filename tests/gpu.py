"""Requirements of tests that render with gsplat on a real GPU."""

from importlib.util import find_spec

import pytest
import torch

DEVICE = "cuda"
NEEDS_GPU = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device"),
    pytest.mark.skipif(find_spec("gsplat") is None, reason="needs the gpu extra"),
]
