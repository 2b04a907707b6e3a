"""Packages that must not load heavy modules; `lint-imports` checks the layers (`.ci/run`)."""

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
NEURAL = (
    "splatwire.neural", "splatwire.paper", "splatwire.cli._run_train", "splatwire.cli._trained_gaussians",
    "splatwire.cli._training",
    "splatwire.cli._run_calibrate_gnn",
)  # fmt: skip
"""The neural part, the paper's, and the verbs that train, which need torch."""
OTHERS = ("splatwire.__main__",)
"""Code that runs on import."""


@pytest.mark.parametrize("package", ["bitstream", "channel", "transport", "files", "errors"])
def test_a_relay_runs_without_torch(package):
    """A fresh interpreter shows that no other module loads them."""
    code = (
        "import importlib, pkgutil, sys\n"
        f"module = importlib.import_module('splatwire.{package}')\n"
        "for info in pkgutil.iter_modules(getattr(module, '__path__', [])):\n"
        "    importlib.import_module(module.__name__ + '.' + info.name)\n"
        "heavy = {'torch', 'numba', 'scipy', 'jaxtyping', 'PIL', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_core_loads_without_torch():
    """Imports every module outside of the neural part in a fresh interpreter without torch."""
    code = (
        "import importlib, pkgutil, sys\n"
        "class Absent:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] in ('torch', 'gsplat'):\n"
        "            raise ModuleNotFoundError(name, name=name)\n"
        "sys.meta_path.insert(0, Absent())\n"
        "import splatwire\n"
        f"neural, others = {NEURAL!r}, {OTHERS!r}\n"
        "for info in pkgutil.walk_packages(splatwire.__path__, 'splatwire.', onerror=lambda name: None):\n"
        "    if not info.name.startswith(neural) and info.name not in others:\n"
        "        importlib.import_module(info.name)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_native_code_loads_on_first_use_only():
    """Importing codec, render or conceal must not compile anything."""
    code = (
        "import sys, splatwire.codec, splatwire.render, splatwire.concealment\n"
        "sys.exit('numba was loaded' if 'numba' in sys.modules else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_only_the_command_line_prints():
    """Complements ruff's T20, which finds print() but not writes to the standard streams."""
    for path in (REPOSITORY / "src" / "splatwire").rglob("*.py"):
        if "cli" not in path.parts:
            assert "sys.stdout" not in path.read_text(encoding="utf-8"), path


def test_no_module_unpickles():
    for path in (REPOSITORY / "src" / "splatwire").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert "import pickle" not in text, path
        assert text.count("torch.load(") == text.count("weights_only=True"), path
        assert "allow_pickle=True" not in text, path
