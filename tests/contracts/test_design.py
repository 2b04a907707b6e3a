"""The table of packages in docs/design.md agrees with the source tree and with the import contracts."""

import re
import tomllib
from pathlib import Path

import splatwire

SOURCE = Path(splatwire.__file__).parent
REPOSITORY = Path(__file__).resolve().parents[2]
DESIGN = (REPOSITORY / "docs" / "design.md").read_text(encoding="utf-8")
NOT_PACKAGES = {"__init__", "__main__", "version", "assets", "web", "__pycache__", "py"}


def _rows() -> list[tuple[list[str], str]]:
    """Packages and description of each row of the table of packages."""
    table = DESIGN.split("## Packages")[1].split("\n## ")[0]
    rows = [line.split("|")[1:3] for line in table.splitlines() if line.startswith("| `")]
    return [(re.findall(r"`(\w+)`", packages), words) for packages, words in rows]


def test_table_lists_every_package_once():
    there = {path.stem for path in SOURCE.iterdir()} - NOT_PACKAGES
    named = [package for packages, _ in _rows() for package in packages]
    assert sorted(named) == sorted(there)


def test_table_matches_the_layers_of_the_contracts():
    """A package may import the packages above it in the table, never those below."""
    contracts = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = next(c for c in contracts["contracts"] if c["type"] == "layers")["layers"]
    level = {
        package.strip().partition(".")[0]: n for n, layer in enumerate(layers[::-1]) for package in layer.split("|")
    }
    order = [level[package] for packages, _ in _rows() for package in packages]
    assert order == sorted(order)
