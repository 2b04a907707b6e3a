"""A clip on a page: it plays, pauses, seeks, loops, and conceals packets that are dropped on purpose."""

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


def slide(page: Browser, which: str, value: float) -> None:
    page.evaluate(
        f"(() => {{const slider = {PANEL}.querySelector('{which}'); slider.value = '{value}'; "
        "slider.dispatchEvent(new Event('input'))})()"
    )


def cell(name: str) -> str:
    """What says what a row of the panel says."""
    return f"[...{PANEL}.querySelectorAll('dt')].find((dt) => dt.textContent === '{name}')?.nextSibling.textContent"


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_a_clip_plays_and_its_losses_are_concealed(tmp_path: Path) -> None:
    stream, _ = encode_clip(moving_frames(900, FRAMES), ClipOptions(Fraction(8), 3))
    packed = tmp_path / "clip.html"
    packed.write_bytes(pack_stream(stream, "a clip"))
    with browser() as page:
        page.open(packed.as_uri())
        page.wait_for(f"{ELEMENT}?.status?.verified", 60)
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
