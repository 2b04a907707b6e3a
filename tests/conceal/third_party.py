"""The package of docs/your-own-concealer.md, installed into a folder without network and without a build."""

import re
import tomllib
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "your-own-concealer.md"


def install_swell(folder: Path) -> Path:
    """Puts module and metadata of the page's package into a folder, which is to be put on the path."""
    text = PAGE.read_text(encoding="utf-8")
    (module,) = re.findall(r"```py\n(.*?)```", text, re.DOTALL)
    (project,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (folder / "swell.py").write_text(module, encoding="utf-8")
    announce(folder, tomllib.loads(project)["project"])
    return folder


def announce(folder: Path, project: dict) -> None:
    """Writes what an installer makes of `[project]`: the metadata by which a package is found."""
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    head = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (info / "METADATA").write_text(head, encoding="utf-8")
    points = project["entry-points"]["splatwire.concealers"]
    lines = [f"{name} = {value}" for name, value in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[splatwire.concealers]", *lines, ""]), encoding="utf-8")
