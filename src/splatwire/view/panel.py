"""The controls of the viewer's page, and what they say."""

import math
from collections.abc import Callable
from typing import Any

from splatwire.view.model import LAYERS, LIVE_LAYERS, Settings, Status


class Panel:
    """Controls on a viser server, shared by everybody who looks at the page.

    Args:
        server: The viser server.
        settings: What is chosen at first.
        concealers: Names to choose from.
        live: Whether losses are real, so that nobody can choose them.
        changed: Called, in some thread, when a person has changed something.
    """

    def __init__(
        self, server: Any, settings: Settings, concealers: tuple[str, ...], *, live: bool, changed: Callable[[], None]
    ) -> None:
        gui = server.gui
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        gui.set_panel_label("splatwire")
        self._live = live
        self._status = gui.add_markdown("starting")
        self._concealer = gui.add_dropdown("Concealer", concealers, initial_value=settings.concealer)
        self._layer = gui.add_dropdown("Show", LIVE_LAYERS if live else LAYERS, initial_value=settings.layer)
        self._reference = gui.add_checkbox("Lossless picture", False, visible=not live, hint="The scene without loss.")
        with gui.add_folder("Losses", visible=not live):
            self._loss = gui.add_slider("Loss, %", 0, 90, 1, round(100 * settings.loss))
            self._burst = gui.add_slider("Burst", 1, 50, 1, round(settings.burst), hint="Mean length, packets.")
            self._seed = gui.add_number("Seed", settings.seed, min=0, max=2**31, step=1)
        with gui.add_folder("Transfer", visible=not live):
            self._progress = gui.add_slider("Sent, %", 0.0, 100.0, 0.5, 100.0 * settings.progress)
            self._play = gui.add_checkbox("Play", False, hint="Plays the transfer at the rate of the link.")
        self.settings, self.playing = settings, False
        controls = (self._concealer, self._layer, self._reference, self._loss, self._burst, self._seed, self._play)
        for control in (*controls, self._progress):
            control.on_update(lambda _: self._read(changed))
        self._setting = False

    def _read(self, changed: Callable[[], None]) -> None:
        if self._setting:
            return
        layer = LAYERS[1] if self._reference.value else self._layer.value
        self.settings = Settings(
            self._loss.value / 100, float(self._burst.value), int(self._seed.value), self._concealer.value,
            self._progress.value / 100, layer,
        )  # fmt: skip
        if self._play.value and not self.playing and self._progress.value >= 100:
            self.move_to(0.0)
        self.playing = bool(self._play.value)
        changed()

    @property
    def concealers(self) -> tuple[str, ...]:
        """Names to choose from."""
        return tuple(self._concealer.options)

    def offer(self, concealers: tuple[str, ...]) -> None:
        """Adds to them."""
        have = self.concealers
        if new := tuple(name for name in concealers if name not in have):
            self._concealer.options = (*have, *new)

    def move_to(self, progress: float) -> None:
        """Moves the transfer to some share; at its end the play button comes up."""
        self._setting = True
        try:
            self._progress.value = round(200 * progress) / 2
            if progress >= 1 and self.playing:
                self._play.value = self.playing = False
        finally:
            self._setting = False
        s = self.settings
        self.settings = Settings(s.loss, s.burst, s.seed, s.concealer, progress, s.layer)

    def say(self, status: Status) -> None:
        """Writes what is known about the picture."""
        text = status_text(status, live=self._live)
        if self._status.content != text:
            self._status.content = text

    def complain(self, problem: str) -> None:
        """Says why there is no picture."""
        self._status.content = "**This cannot be shown.** " + " ".join(problem.split())


def status_text(status: Status, *, live: bool = False) -> str:
    """The overlay, as Markdown; a live view has no lossless render and thus no PSNR."""
    total = "" if status.bytes_total is None else f" of {status.bytes_total / 1e3:,.0f}"
    share = status.known / max(status.total, 1)
    lines = [
        f"**{status.bytes_sent / 1e3:,.0f}{total} kB**, {status.seconds:.2f} s",
        f"{status.packets_received} of {status.packets_total} packets, {100 * share:.1f} % of the scene",
        *([] if live else [f"**PSNR {_decibels(status.psnr)}** against the lossless render"]),
        f"drawn in {status.draw_ms:.0f} ms",
    ]
    if status.note:
        lines.append(f"*{status.note}*")
    return "  \n".join(lines)


def _decibels(psnr: float | None) -> str:
    if psnr is None:
        return "-"
    return "infinite (identical)" if math.isinf(psnr) else f"{psnr:.2f} dB"
