"""Fixtures of the whole suite."""

import gc
import os
import re
import signal
import sys
from importlib.util import find_spec
from pathlib import Path

import jaxtyping
import pytest

import type_checks

jaxtyping.jaxtyped = type_checks.checking  # set before any import of the package: its import hook calls this
# OpenMP threads, including those of torch, sleep while they wait, as on the command line. On a busy machine spinning
# takes ten times the time of the work. The variable must be set before torch is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

gc.disable()  # until all modules are imported: hardly anything is freed before

LONGEST = ("web", "neural", "transport", "evaluation", "cli", "sequence")
"""Folders with the slowest modules, which are distributed first so that all workers end together."""
NEURAL = ("neural", "parity", "paper")
"""Folders with tests of what needs torch."""
PAPER = {"cari", "gnn", "idw", "kriging", "prior"}
"""Concealers of the paper, which need torch."""
NEEDS_TORCH = re.compile(r"^(from|import) (torch|splatwire\.(neural|paper))\b|^MADE = runpy.run_path", re.MULTILINE)
REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real photos and models; dependent tests skip without it."""
    folder = Path(os.environ.get("SPLATWIRE_DATA", REPOSITORY.parent / "shared" / "data"))
    if not (folder / "hacpp").is_dir():
        pytest.skip(f"no real data at {folder}; set SPLATWIRE_DATA to its folder")
    return folder


def _without_torch() -> bool:
    try:
        return find_spec("torch") is None
    except ModuleNotFoundError:
        return True


if _without_torch():
    # the remaining tests are those of the core
    _TESTS = Path(__file__).parent
    collect_ignore = [
        *(str(_TESTS / folder) for folder in NEURAL),
        *(str(path) for path in sorted(_TESTS.rglob("test_*.py")) if NEEDS_TORCH.search(path.read_text())),
    ]


def pytest_configure() -> None:
    """Lets commands that tests start react to SIGINT, which background jobs of a shell script ignore."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_report_header() -> str | None:
    """States how many modules an installation without torch leaves out."""
    return f"without torch: {len(collect_ignore)} folders and modules are left out" if _without_torch() else None


def pytest_collection_finish() -> None:
    """Excludes all modules and collected tests from garbage collections, which take a second with them."""
    gc.freeze()
    gc.enable()


def pytest_unconfigure() -> None:
    """Ends the browser that tests of pages shared."""
    if chromium := sys.modules.get("transport.chromium"):
        chromium.end_shared_browser()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Puts the slowest folders first, one module of each in turn, so that workers run tests of different folders.

    Tests of one folder keep workers waiting together: for the same kernels to be compiled, or for time to pass.
    """
    turns: dict[str, dict[Path, int]] = {}
    last = len(items)

    def place(item: pytest.Item) -> tuple[int, int]:
        folder = item.path.relative_to(REPOSITORY / "tests").parts[0]
        if folder not in LONGEST:
            return last, 0
        modules = turns.setdefault(folder, {})
        return modules.setdefault(item.path, len(modules)), LONGEST.index(folder)

    items.sort(key=place)
    if _without_torch():
        for item in items:
            values = (
                item.callspec.params.values() if isinstance(item, pytest.Function) and hasattr(item, "callspec") else ()
            )
            if item.get_closest_marker("needs_torch") or PAPER & {value for value in values if isinstance(value, str)}:
                item.add_marker(pytest.mark.skip(reason="needs torch"))
