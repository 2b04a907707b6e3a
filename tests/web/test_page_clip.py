"""A clip on a page: play, pause, seek, loop, rest while invisible, and concealment of dropped packets."""

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import pytest

from moving_sequences import moving_frames
from splatwire.sequence import SequenceOptions, encode_sequence
from splatwire.transport.http.pack import pack_stream
from transport.chromium import Browser, executable, isolated_page
from web.pictures import ELEMENT

pytestmark = pytest.mark.slow

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
"""Counts frames that pages request from their workers from now on."""


def slide(page: Browser, which: str, value: float) -> None:
    page.evaluate(
        f"(() => {{const slider = {PANEL}.querySelector('{which}'); slider.value = '{value}'; "
        "slider.dispatchEvent(new Event('input'))})()"
    )


def cell(name: str) -> str:
    """Expression for the text of a row of the panel."""
    return f"[...{PANEL}.querySelectorAll('dt')].find((dt) => dt.textContent === '{name}')?.nextSibling.textContent"


@contextmanager
def clip_page(folder: Path, num_gaussians: int) -> Iterator[Browser]:
    """A browser that has loaded a whole clip."""
    stream, _ = encode_sequence(moving_frames(num_gaussians, FRAMES), SequenceOptions(Fraction(8), 3))
    packed = folder / "clip.html"
    packed.write_bytes(pack_stream(stream, "a clip"))
    with isolated_page() as page:
        page.open(packed.as_uri())
        page.wait_for(f"{ELEMENT}?.status?.verified")
        yield page


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_clip_plays_with_concealed_losses(tmp_path: Path) -> None:
    with clip_page(tmp_path, 900) as page:
        assert "lossless" not in page.evaluate(f"{PANEL}.textContent"), "there is no comparison of what moves"
        first = page.wait_for(TOLD)
        page.wait_for(f"{TOLD} !== {first!r}")
        slide(page, ".player input", 4)
        page.wait_for(f"{TOLD} === 'frame 5 of {FRAMES}' && {cell('Gaussians')} === '900'")
        assert page.evaluate(f"{PLAYER}.querySelector('button').textContent") == "play"
        slide(page, ".player input", 0)  # some tracks start later
        page.wait_for(f"{TOLD} === 'frame 1 of {FRAMES}' && {cell('Gaussians')} === '882'")
        assert page.evaluate(cell("motion concealed")) == "none"
        slide(page, "label input[type=range]", 0.6)
        page.wait_for(f"{cell('motion concealed')}?.endsWith('tracks')")
        page.evaluate(f"{PLAYER}.querySelector('button').click()")
        page.wait_for(f"{TOLD} !== 'frame 1 of {FRAMES}'")


QUIET = """(async () => {
  const pause = new Promise((resolve) => setTimeout(resolve, 1000));
  for (let n = 0; n < 60; n++) await new Promise(requestAnimationFrame);
  await pause;
})()"""


def rests(page: Browser) -> bool:
    """True if the page draws 60 times without asking for another frame of the clip, in a second or more."""
    for _ in range(60):
        page.evaluate("window.asked = 0")
        page.resolve(QUIET)
        if page.evaluate("window.asked") == 0:
            return True
    return False


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_invisible_clip_decodes_no_frames(tmp_path: Path) -> None:
    with clip_page(tmp_path, 300) as page:
        page.wait_for(f"{ELEMENT}.view")
        page.evaluate(COUNT)
        page.wait_for("window.asked > 2")
        page.evaluate(f"{ELEMENT}.style.cssText = 'position: absolute; inset: auto; top: 300vh; height: 50vh'")
        assert rests(page)
        assert page.evaluate(f"{PLAYER}.querySelector('button').textContent") == "pause", "it goes on where it is seen"
        page.evaluate(f"{ELEMENT}.removeAttribute('style')")
        page.wait_for("window.asked > 2")


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_requests_before_a_clip_arrives_take_effect_when_it_does(tmp_path: Path) -> None:
    with clip_page(tmp_path, 300) as page:
        page.evaluate(
            f"(() => {{ const old = {ELEMENT}, fresh = old.cloneNode(); fresh.pause(); fresh.currentTime = 4 / 8;"
            "old.replaceWith(fresh); })()"
        )
        assert page.evaluate(f"[{ELEMENT}.currentTime, {ELEMENT}.paused]") == [0.5, True]
        page.wait_for(f"{ELEMENT}?.status?.verified && {ELEMENT}.duration")
        assert page.evaluate(f"[{ELEMENT}.currentTime, {ELEMENT}.paused]") == [0.5, True]
        found = page.evaluate(  # at once: it may play to its end before another request
            f"(() => {{ const old = {ELEMENT}, fresh = old.cloneNode(); fresh.currentTime = 4 / 8; fresh.play();"
            "old.replaceWith(fresh); return [fresh.duration, fresh.paused]; })()"
        )
        assert found == [0, False]
        page.wait_for(f"{ELEMENT}?.status?.verified && {ELEMENT}.duration")
        assert page.evaluate(f"{ELEMENT}.paused") is False


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
@pytest.mark.parametrize(
    "call",
    ["verify()", "picture({viewmat: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]], focal: 60, height: 64})"],
)
def test_promises_of_a_removed_element_reject(tmp_path: Path, call: str) -> None:
    with clip_page(tmp_path, 300) as page:
        found = page.resolve(
            f"(() => {{ const old = {ELEMENT}, fresh = old.cloneNode(); old.replaceWith(fresh);"
            f"const promise = fresh.{call}; fresh.remove();"
            "return promise.then(() => 'settled', (error) => error.message); })()"
        )
        assert "removed" in found
