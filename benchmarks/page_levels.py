"""A page that walks through a scene with levels: Gaussians, memory and the longest tasks of its main thread.

    python benchmarks/page_levels.py city.swz taebak.swz [--pictures FOLDER] > page_levels.json

Headless Chromium loads the scene by byte ranges from `serve --page`. The walk begins where all of the scene is in the
window. By mouse and keyboard the camera rises, orbits the centre, approaches it, orbits again and returns. `--pictures`
records every change of the screen. `tasks` are tasks of the main thread in the browser's trace: wall and processor time
of the longest one, and of the one with the most processor time, with their parts. The difference is waiting, for the
software rasteriser or for the processor. `messages` is the time of handling messages of the worker, by kind. Memory is
the private memory of processes.
"""

import argparse
import asyncio
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from splatwire.transport.http.content import PageContent
from splatwire.transport.http.server import PageServer

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "transport"))
from chromium import Browser, browser

ELEMENT = "document.querySelector('splat-wire')"
WATCH = """
window.spent = {};
const set = Object.getOwnPropertyDescriptor(Worker.prototype, "onmessage");
const timed = (work) => function (event) {
  const began = performance.now(), kind = event.data?.kind ?? "other";
  try { return work.call(this, event); } finally {
    const ms = performance.now() - began, had = spent[kind] ?? {count: 0, longest: 0, total: 0};
    spent[kind] = {count: had.count + 1, longest: Math.max(had.longest, ms), total: had.total + ms};
  }
};
Object.defineProperty(Worker.prototype, "onmessage", {...set, set(work) { set.set.call(this, timed(work)); }});
const add = Worker.prototype.addEventListener;
Worker.prototype.addEventListener = function (kind, work, ...more) {
  return add.call(this, kind, kind === "message" ? timed(work) : work, ...more);
};
"""
STEPS = ["up", "focus", "right", *["in"] * 6, "left", "focus", *["in"] * 5, *["right"] * 2, *["out"] * 8, "home"]
LONGEST = 20.0
"""Seconds that a step is recorded until its picture: rasterisers draw large scenes for seconds."""
DRAGS = {"left": (-25, 0), "right": (25, 0), "up": (0, 100)}
STATUS = f"{ELEMENT}?.status"
PARTS = {"FunctionCall", "FireAnimationFrame", "TimerFire", "HandlePostMessage", "EventDispatch", "MajorGC", "MinorGC",
         "v8.compile", "EvaluateScript", "Layout", "Commit"}  # fmt: skip


def walked(page: Browser, url: str, given: argparse.Namespace, pictures: Path | None) -> dict[str, Any]:
    """Opens a page and walks."""
    page.patience = 240.0  # a screenshot waits for the queue of the rasteriser
    page.emulate(*given.size)
    page._call("Page.enable", page._session)
    page._call("Page.addScriptToEvaluateOnNewDocument", page._session, source=WATCH)
    page.start_trace()
    page.open(url)
    page.wait_for(STATUS, 120)
    watched(page, 5 * given.seconds, pictures, "opening")
    page.wait_for(f"{STATUS}?.gaussians > 1000", 120)
    most = {"gaussians": 0, "page_mb": 0, "gpu_mb": 0}
    opening = traced(page)
    page.evaluate("spent = {};")
    page.start_trace()
    for number, step in enumerate(STEPS):
        went(page, step, (given.size[0] / 2, given.size[1] / 2))
        watched(page, (5 if step == "home" else 1) * given.seconds, pictures, f"{number:02}-{step}")
        print(f"{number}: {step}", file=sys.stderr)
        most["gaussians"] = max(most["gaussians"], page.evaluate(f"{STATUS}.gaussians"))
        most["page_mb"] = max(most["page_mb"], page.memory() // 1_000_000)
        most["gpu_mb"] = max(most["gpu_mb"], page.memory("GPU") // 1_000_000)
    return {
        **most, "packets": page.evaluate(f"{STATUS}.packets"), "tasks_opening": opening, "tasks": traced(page),
        "messages": page.evaluate("spent"), "failed": page.evaluate(f"{STATUS}.failed"), "load": os.getloadavg()[0],
    }  # fmt: skip


def went(page: Browser, step: str, middle: tuple[float, float]) -> None:
    """Performs one step of the walk by mouse or keyboard."""
    if step in ("in", "out"):
        page.wheel(*middle, -250 if step == "in" else 250)
    elif step in DRAGS:
        page.drag(middle, (middle[0] + DRAGS[step][0], middle[1] + DRAGS[step][1]))
    elif step == "focus":
        page.double_click(*middle)
    else:
        page.evaluate(f"{ELEMENT}.shadowRoot.querySelector('.scene').focus()")
        page.key("Home")


def watched(page: Browser, seconds: float, pictures: Path | None, name: str) -> None:
    """Waits, and saves every change of the screen."""
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
        for number, frame in enumerate(page.recorded(seconds, LONGEST)):
            (pictures / f"{name}-{number:02}.png").write_bytes(frame)
    else:
        time.sleep(seconds)


def traced(page: Browser) -> dict[str, Any]:
    """Ends the trace and returns the main thread's tasks."""
    events = page.trace_events()
    pages = {e["pid"] for e in events if e["name"] == "process_name" and e["args"]["name"] == "Renderer"}
    named = (e for e in events if e["name"] == "thread_name" and e["args"]["name"] == "CrRendererMain")
    main = {(e["pid"], e["tid"]) for e in named if e["pid"] in pages}  # the browser's own surroundings are pages, too
    mine = [e for e in events if e.get("ph") == "X" and (e["pid"], e["tid"]) in main and "dur" in e]
    tasks = [e for e in mine if e["name"].endswith("RunTask") or e["name"] == "RunTask"]

    def describe_task(task: dict[str, Any]) -> dict[str, Any]:
        inside = [e for e in mine if task["ts"] <= e["ts"] < task["ts"] + task["dur"] and e["name"] in PARTS]
        parts: dict[str, float] = {}
        for e in inside:
            parts[e["name"]] = max(parts.get(e["name"], 0), e["dur"] / 1e3)
        return {"ms": task["dur"] / 1e3, "processor_ms": task.get("tdur", 0) / 1e3, "parts": parts}

    if not tasks:
        return {"count": 0}
    longest, busiest = (max(tasks, key=lambda e, key=key: e.get(key, 0)) for key in ("dur", "tdur"))
    over = {key: sum(e.get(key, 0) > 50_000 for e in tasks) for key in ("dur", "tdur")}
    return {"count": len(tasks), "longest": describe_task(longest), "busiest": describe_task(busiest),
            "over_50_ms": over["dur"],
            "processor_over_50_ms": over["tdur"]}  # fmt: skip


async def served(stream: Path, given: argparse.Namespace) -> dict[str, Any]:
    """Measures a page that loads a file from a server while the camera moves."""
    async with PageServer(PageContent({"city": stream.read_bytes()})) as server:

        def drive() -> dict[str, Any]:
            with browser() as page:
                return walked(page, server.url, given, given.pictures and given.pictures / stream.stem)

        return await asyncio.to_thread(drive)


def main() -> None:
    """Prints one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("streams", type=Path, nargs="+", help="streams with levels")
    parser.add_argument("--seconds", type=float, default=1.0, help="of a step")
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), help="of the window, pixels")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the walk")
    given = parser.parse_args()
    print(json.dumps({stream.stem: asyncio.run(served(stream, given)) for stream in given.streams}, indent=1))


if __name__ == "__main__":
    main()
