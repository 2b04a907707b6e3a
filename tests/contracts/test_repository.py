"""Promises of the repository itself."""

import re
from pathlib import Path

import pytest
import tomllib

REPOSITORY = Path(__file__).resolve().parents[2]
MAX_DEMO_BYTES = 6_000_000


def _project():
    return tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))


def _name(requirement: str) -> str:
    return re.sub(r"[-_.]+", "-", re.split(r"[\s<>=!~\[;]", requirement, maxsplit=1)[0]).lower()


def test_every_requirement_is_pinned():
    lines = (REPOSITORY / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    project = _project()
    wanted = project["project"]["dependencies"] + project["dependency-groups"]["dev"]
    assert {_name(requirement) for requirement in wanted} <= set(pins)
    assert pins["torch"] == "2.13.0"


def test_no_dependency_has_a_viral_licence():
    """GPL and LGPL packages that this field likes to use, by name."""
    text = (REPOSITORY / "constraints.txt").read_text(encoding="utf-8")
    assert not re.search(r"^(torchac|zfec|plyfile|pykdtree)==", text, re.MULTILINE)


def test_the_bundled_scene_is_small():
    assets = [path for path in (REPOSITORY / "src" / "splatwire" / "assets").rglob("*") if path.is_file()]
    assert assets
    assert sum(path.stat().st_size for path in assets) <= MAX_DEMO_BYTES


@pytest.mark.parametrize("path", ["README.md", "CHANGELOG.md", "docs/design.md", "docs/format.md",
                                  "docs/determinism.md", "docs/paper-map.md"])  # fmt: skip
def test_local_links_of_documents_lead_somewhere(path):
    document = REPOSITORY / path
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", document.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (document.parent / target).exists(), f"{path} points to {target}"


def test_the_readme_commands_are_the_ones_that_ci_runs():
    assert ".ci/run" in (REPOSITORY / "README.md").read_text(encoding="utf-8")
    assert (REPOSITORY / ".ci" / "run").stat().st_mode & 0o111
