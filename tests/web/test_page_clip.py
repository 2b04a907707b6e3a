"""A clip on a page: it plays, pauses, seeks, loops, rests out of sight, conceals what is dropped on purpose."""

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import pytest

from moving_clips import moving_frames
from splatwire.clips import ClipOptions, encode_clip
from splatwire.transport.pack import pack_stream
from transport.chromium import Browser, browser, executable
from web.pictures import ELEMENT

PANEL = f"{ELEMENT}?.shadowRoot?.querySelector('.panel')"
PLAYER = f"{PANEL}?.querySelector('.player')"
TOLD = f"{PLAYER}?.querySelector('output').textContent"
FRAMES = 9
COUNT = """(() => {
  window.asked = 0;
  const post = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (...given) {
    if (given[0].kind === "frame") window.asked++;
    post.apply(this, given);
  };
  return true;
})()"""
"""Counts frames that pages ask their workers for from here on."""


def slide(page: Browser, which: str, value: float) -> None:
    page.evaluate(
        f"(() => {{const slider = {PANEL}.querySelector('{which}'); slider.value = '{value}'; "
        "slider.dispatchEvent(new Event('input'))})()"
    )


def cell(name: str) -> str:
    """What says what a row of the panel says."""
    return f"[...{PANEL}.querySelectorAll('dt')].find((dt) => dt.textContent === '{name}')?.nextSibling.textContent"


@contextmanager
def clip_page(folder: Path, num_gaussians: int) -> Iterator[Browser]:
    """A browser that has read a whole clip of so many Gaussians."""
    stream, _ = encode_clip(moving_frames(num_gaussians, FRAMES), ClipOptions(Fraction(8), 3))
    packed = folder / "clip.html"
    packed.write_bytes(pack_stream(stream, "a clip"))
    with browser() as page:
        page.open(packed.as_uri())
        page.wait_for(f"{ELEMENT}?.status?.verified", 60)
        yield page


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_a_clip_plays_and_its_losses_are_concealed(tmp_path: Path) -> None:
    with clip_page(tmp_path, 900) as page:
        assert "lossless" not in page.evaluate(f"{PANEL}.textContent"), "there is no comparison of what moves"
        first = page.wait_for(TOLD, 60)
        page.wait_for(f"{TOLD} !== {first!r}", 60)
        slide(page, ".player input", 4)
        page.wait_for(f"{TOLD} === 'frame 5 of {FRAMES}' && {cell('Gaussians')} === '900'", 60)
        assert page.evaluate(f"{PLAYER}.querySelector('button').textContent") == "play"
        slide(page, ".player input", 0)  # where some are not born yet
        page.wait_for(f"{TOLD} === 'frame 1 of {FRAMES}' && {cell('Gaussians')} === '882'", 60)
        assert page.evaluate(cell("motion concealed")) == "none"
        slide(page, "label input[type=range]", 0.6)
        page.wait_for(f"{cell('motion concealed')}?.endsWith('tracks')", 60)
        page.evaluate(f"{PLAYER}.querySelector('button').click()")
        page.wait_for(f"{TOLD} !== 'frame 1 of {FRAMES}'", 60)


def rests(page: Browser) -> bool:
    """Whether a second passes in which no frame is asked for, within half a minute."""
    for _ in range(30):
        page.evaluate("window.asked = 0")
        page.resolve("new Promise((resolve) => setTimeout(resolve, 1000))")
        if page.evaluate("window.asked") == 0:
            return True
    return False


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_a_clip_that_nobody_sees_decodes_no_frames(tmp_path: Path) -> None:
    with clip_page(tmp_path, 300) as page:
        page.wait_for(f"{ELEMENT}.view", 60)
        page.evaluate(COUNT)
        page.wait_for("window.asked > 2", 60)
        page.evaluate(f"{ELEMENT}.style.cssText = 'position: absolute; inset: auto; top: 300vh; height: 50vh'")
        assert rests(page)
        assert page.evaluate(f"{PLAYER}.querySelector('button').textContent") == "pause", "it goes on where it is seen"
        page.evaluate(f"{ELEMENT}.removeAttribute('style')")
        page.wait_for("window.asked > 2", 60)
