"""The projects of `examples/web` build with the packed npm package; the React component shows a stream."""

import asyncio
import json
import re
import shutil
from pathlib import Path

import pytest

from explicit import encode_splats
from splatwire.bitstream import stream_to_bytes
from transport.chromium import Browser, executable, isolated_page
from web.host import hosting
from web.installed import called, install, package
from web.test_page import SMALL, ball, run

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples" / "web"
NAMES = ("next", "react", "svelte", "vite", "vue")
UNVERSIONED = ("node_modules", "dist", ".next")


@pytest.fixture(scope="module")
def projects(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copies of the examples; all use the packages of their common parent, which are installed once."""
    folder = tmp_path_factory.mktemp("examples")
    shutil.copytree(EXAMPLES, folder, ignore=shutil.ignore_patterns(*UNVERSIONED), dirs_exist_ok=True)
    wanted: dict[str, str] = {}
    for project in NAMES:
        needs = json.loads((folder / project / "package.json").read_text())
        for name, version in (needs["dependencies"] | needs["devDependencies"]).items():
            assert wanted.setdefault(name, version) == version, f"{project} wants another version of {name}"
    install(folder, package(tmp_path_factory), {name: v for name, v in wanted.items() if name != "splatwire"})
    return folder


def built(name: str, projects: Path) -> Path:
    called(["npm", "run", "--silent", "build"], projects / name)
    return projects / name


def test_all_imported_packages_are_dependencies() -> None:
    """Holds although the tests install the packages of all examples together."""
    for name in NAMES:
        needs = json.loads((EXAMPLES / name / "package.json").read_text())
        files = [p for p in (EXAMPLES / name).rglob("*.*") if not set(p.parts) & set(UNVERSIONED)]
        code = "\n".join(path.read_text() for path in files if path.suffix != ".json")
        used = set(re.findall(r"""(?:from|import)\s*["']((?:@[\w-]+/)?[\w-]+)""", code))
        used |= {words.split()[0] for words in needs["scripts"]["build"].split(" && ")}
        provided = {*needs["dependencies"], *needs["devDependencies"]}
        provided |= {"tsc"} if "typescript" in provided else set()
        assert "splatwire" in used
        assert used <= provided, name


@pytest.mark.extended
@pytest.mark.parametrize("name", ["vite", "svelte", "vue"])
def test_example_builds(name: str, projects: Path) -> None:
    scripts = list((built(name, projects) / "dist" / "assets").glob("*.js"))
    assert any("splat-wire" in path.read_text() for path in scripts)


@pytest.mark.extended
def test_example_of_next_renders_the_element_on_the_server(projects: Path) -> None:
    project = built("next", projects)
    page = (project / ".next" / "server" / "app" / "index.html").read_text()
    assert '<splat-wire src="/scene.swz" style="height:30rem"></splat-wire>' in page


@pytest.mark.extended
@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_react_component_shows_a_stream_and_passes_its_events_on(projects: Path) -> None:
    dist = built("react", projects) / "dist"
    scripts = {f"assets/{path.name}": path.read_text() for path in (dist / "assets").iterdir()}
    page = (dist / "index.html").read_text()
    # an address without a base, which the element reports at once
    baseless = (
        "<script>document.head.append(Object.assign(document.createElement('base'), {href: 'mailto:a'}))</script>"
    )

    def drive(url: str, opened: Browser) -> None:
        opened.open(f"{url}index.html")
        opened.wait_for("document.querySelector('p')?.textContent === 'verified'")
        element = "document.querySelector('splat-wire')"
        assert opened.evaluate(f"{element}.getAttribute('autorotate')") == "6"
        assert opened.evaluate(f"{element}.status.complete") is True
        opened.open(f"{url}baseless.html")
        opened.wait_for("document.querySelector('p')?.textContent.includes('not a valid URL')")

    async def work() -> None:
        stream = stream_to_bytes(encode_splats(ball(), SMALL))
        pages = {"index.html": page, "baseless.html": f"{page}{baseless}"}
        async with hosting(pages, {"scene.swz": stream}, scripts) as host:
            with isolated_page() as opened:
                await asyncio.to_thread(drive, host.url, opened)

    run(work())
