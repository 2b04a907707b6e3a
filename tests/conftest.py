"""Fixtures of the whole suite."""

import os
from pathlib import Path

import jaxtyping
import pytest

import type_checks

jaxtyping.jaxtyped = type_checks.checking  # before anything of the package is imported: its import hook calls it
# As on the command line: OpenMP's threads, torch's too, sleep while they wait. Beside other work, spinning costs ten
# times the work itself. It must be set before torch is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

LONGEST = ("web", "train", "transport", "evaluate", "cli", "clips")
"""Folders whose modules take longest: they are handed out first, so that all workers end together."""
REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real photos and models; tests that ask for it skip where it is not there."""
    folder = Path(os.environ.get("SPLATWIRE_DATA", REPOSITORY.parent / "shared" / "data"))
    if not (folder / "hacpp").is_dir():
        pytest.skip(f"no real data at {folder}; set SPLATWIRE_DATA to its folder")
    return folder


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Puts the longest folders first."""

    def place(item: pytest.Item) -> int:
        folder = item.path.relative_to(REPOSITORY / "tests").parts[0]
        return LONGEST.index(folder) if folder in LONGEST else len(LONGEST)

    items.sort(key=place)
