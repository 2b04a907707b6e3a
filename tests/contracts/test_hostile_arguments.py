"""Every public function and constructor answers wrong arguments with one error that names the argument.

`hostile_arguments` makes the calls in a separate process, without this suite's checks of annotations.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hostile_arguments import PACKAGES

pytestmark = pytest.mark.slow

PROGRAM = Path(__file__).resolve().parents[1] / "hostile_arguments.py"


@pytest.fixture(scope="module")
def problems(tmp_path_factory) -> dict[str, dict[str, str]]:
    """Raw errors by package and call."""
    folder = tmp_path_factory.mktemp("hostile")
    command = [sys.executable, str(PROGRAM), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.needs_torch
@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package or "splatwire")
def test_wrong_arguments_of_public_names_are_one_clear_error(problems, package):
    assert problems[package] == {}
