"""Third-party packages that are installed into a folder without network or build."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"


def install_page(page: str, folder: Path) -> Path:
    """Writes the package of a page of docs/ into a folder that the caller adds to the path.

    Files are the blocks that follow "File `NAME`"; one of them is `pyproject.toml`.
    """
    folder.mkdir(exist_ok=True)
    text = (DOCS / page).read_text(encoding="utf-8")
    files = dict(re.findall(r"File `([\w.]+)`(?:(?!```).)*```\w+\n(.*?)```", text, re.DOTALL))
    project = tomllib.loads(files.pop("pyproject.toml"))["project"]
    assert files
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")
    announce(folder, project)
    return folder


def announce(folder: Path, project: dict) -> None:
    """Writes the metadata of a package, as an installer does."""
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    head = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (info / "METADATA").write_text(head, encoding="utf-8")
    lines = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items()), ""]
    (info / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")


def run_with(site: Path, folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Runs a command in a process that finds the packages in `site`."""
    path = os.pathsep.join([*filter(None, [os.environ.get("PYTHONPATH")]), str(site)])
    return subprocess.run(
        [sys.executable, "-m", "splatwire", *map(str, words)], cwd=folder, env={**os.environ, "PYTHONPATH": path},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
