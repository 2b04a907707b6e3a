import sys
import types

import pytest
import torch

from splatwire.errors import BackendUnavailableError
from splatwire.render import create_renderer


def test_without_gsplat_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(BackendUnavailableError, match=r"splatwire\[gpu\]"):
        create_renderer("gsplat")


def test_without_a_gpu_the_error_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", types.ModuleType("gsplat"))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(BackendUnavailableError, match="CUDA device"):
        create_renderer("gsplat")
