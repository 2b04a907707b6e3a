"""The projects of `examples/web` build with the packed npm package; the React component shows a stream."""

import asyncio
import shutil
from pathlib import Path

import pytest

from explicit import encode_splats
from splatwire.bitstream import stream_to_bytes
from transport.chromium import Browser, browser, executable
from web.host import hosting
from web.installed import called, install_in_project, package
from web.test_page import SMALL, ball, run

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples" / "web"


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file that `npm publish` would upload."""
    return package(tmp_path_factory.mktemp("package"))


def built(name: str, packed: Path, folder: Path) -> Path:
    project = folder / name
    shutil.copytree(EXAMPLES / name, project, ignore=shutil.ignore_patterns("node_modules", "dist", ".next"))
    install_in_project(project, packed)
    called(["npm", "run", "--silent", "build"], project)
    return project


@pytest.mark.parametrize("name", ["vite", "svelte", "vue"])
def test_example_builds(name: str, packed: Path, tmp_path: Path) -> None:
    scripts = list((built(name, packed, tmp_path) / "dist" / "assets").glob("*.js"))
    assert any("splat-wire" in path.read_text() for path in scripts)


def test_example_of_next_renders_the_element_on_the_server(packed: Path, tmp_path: Path) -> None:
    project = built("next", packed, tmp_path)
    page = (project / ".next" / "server" / "app" / "index.html").read_text()
    assert '<splat-wire src="/scene.swz" style="height:30rem"></splat-wire>' in page


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_react_component_shows_a_stream_and_passes_its_events_on(packed: Path, tmp_path: Path) -> None:
    dist = built("react", packed, tmp_path) / "dist"
    scripts = {f"assets/{path.name}": path.read_text() for path in (dist / "assets").iterdir()}
    page = (dist / "index.html").read_text()

    def drive(url: str, opened: Browser) -> None:
        opened.open(f"{url}index.html")
        opened.wait_for("document.querySelector('p')?.textContent === 'verified'")
        element = "document.querySelector('splat-wire')"
        assert opened.evaluate(f"{element}.getAttribute('autorotate')") == "6"
        assert opened.evaluate(f"{element}.status.complete") is True

    async def work() -> None:
        stream = stream_to_bytes(encode_splats(ball(), SMALL))
        async with hosting({"index.html": page}, {"scene.swz": stream}, scripts) as host:
            with browser() as opened:
                await asyncio.to_thread(drive, host.url, opened)

    run(work())
