"""The floors of the house, and the rooms that must stay light."""

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


def test_import_contracts_hold():
    """Runs the contracts of pyproject.toml, as `lint-imports` does."""
    code = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


@pytest.mark.parametrize("room", ["packets", "channel", "transport", "files", "errors"])
def test_a_relay_runs_without_torch(room):
    """Checked in a fresh interpreter, where nothing else has loaded it."""
    code = (
        "import importlib, pkgutil, sys\n"
        f"module = importlib.import_module('splatwire.{room}')\n"
        "for info in pkgutil.iter_modules(getattr(module, '__path__', [])):\n"
        "    importlib.import_module(module.__name__ + '.' + info.name)\n"
        "heavy = {'torch', 'numba', 'scipy', 'jaxtyping', 'PIL', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_native_code_loads_on_first_use_only():
    """Importing codec, render or conceal must not compile anything."""
    code = (
        "import sys, splatwire.codec, splatwire.render, splatwire.conceal\n"
        "sys.exit('numba was loaded' if 'numba' in sys.modules else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_only_the_command_line_prints():
    """Ruff's T20 guards print(); this guards what it cannot see: direct writes to the standard streams."""
    for path in (REPOSITORY / "src" / "splatwire").rglob("*.py"):
        if "cli" not in path.parts:
            assert "sys.stdout" not in path.read_text(encoding="utf-8"), path


def test_nothing_unpickles():
    for path in (REPOSITORY / "src" / "splatwire").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert "import pickle" not in text, path
        assert text.count("torch.load(") == text.count("weights_only=True"), path
        assert "allow_pickle=True" not in text, path
