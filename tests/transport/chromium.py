"""A headless Chromium, controlled by the DevTools protocol over two pipes without further packages."""

import base64
import contextlib
import json
import os
import select
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from browser_driver import NavigatedError, Page, running

FLAGS = (
    "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--remote-debugging-pipe",
    "--hide-scrollbars", "--force-device-scale-factor=1", "--window-size=400,300",
    # windows and pages that no test opens would have processes of their own
    "--disable-features=PreloadTopChromeWebUI,SpareRendererForSitePerProcess",
)  # fmt: skip

NAVIGATED = {
    "Cannot find context with specified id",
    "Execution context was destroyed.",
    "Inspected target navigated or closed",
}
"""Messages of calls in a document that another one replaced."""
COUNTED = (
    "Nodes", "JSEventListeners", "WorkerGlobalScopes", "ContextLifecycleStateObservers", "ArrayBufferContents",
    "JSHeapUsedSize",
)  # fmt: skip

LAUNCH = """
import os, sys
reads, writes = (os.dup(int(fd)) for fd in sys.argv[1:3])  # moved away first: they may be 3 or 4 already
os.dup2(reads, 13), os.dup2(writes, 14), os.dup2(13, 3), os.dup2(14, 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""The browser reads commands from descriptor 3 and answers on descriptor 4."""


def executable() -> str | None:
    return shutil.which("chromium") or shutil.which("google-chrome") or shutil.which("chrome")


class Connection:
    """The two pipes to a browser. Its pages take turns; each answer has the number of its question."""

    def __init__(self, to_browser: int, from_browser: int) -> None:
        self.out, self.source, self.rest, self.count = to_browser, from_browser, b"", 0


class Browser(Page):
    """One page of a browser."""

    patience = 600.0
    """Timeout of an answer, seconds."""

    def __init__(self, connection: Connection, *, alone: bool = False) -> None:
        self._connection = connection
        whose = {"browserContextId": self._call("Target.createBrowserContext")["browserContextId"]} if alone else {}
        self._origins: set[str] = set()
        self._target = self._call("Target.createTarget", url="about:blank", **whose)["targetId"]
        self._session = self._call("Target.attachToTarget", targetId=self._target, flatten=True)["sessionId"]

    def another(self, *, alone: bool = False) -> "Browser":
        """Opens another page of the same browser; with `alone`, the pages share no storage."""
        return Browser(self._connection, alone=alone)

    def close(self) -> None:
        """Closes the page but not the browser."""
        self._call("Target.closeTarget", targetId=self._target)

    def forget(self) -> None:
        """Clears what the origins of this page stored in the browser."""
        self._call("Network.clearBrowserCache", self._session)
        for origin in self._origins:
            self._call("Storage.clearDataForOrigin", self._session, origin=origin, storageTypes="all")

    def open(self, url: str) -> None:
        if url.startswith("http"):
            self._origins.add("/".join(url.split("/")[:3]))
        self._call("Page.navigate", self._session, url=url)

    def go_back(self) -> None:
        """Returns to the page before, as the back button does."""
        history = self._call("Page.getNavigationHistory", self._session)
        before = history["entries"][history["currentIndex"] - 1]
        self._call("Page.navigateToHistoryEntry", self._session, entryId=before["id"])

    def prepare(self, script: str) -> None:
        """Runs a script at the beginning of each document that is opened later, before the scripts of the page."""
        self._call("Page.enable", self._session)
        self._call("Page.addScriptToEvaluateOnNewDocument", self._session, source=script)

    def evaluate(self, expression: str) -> Any:
        found = self._call("Runtime.evaluate", self._session, expression=expression, returnByValue=True)
        return found["result"].get("value")

    def resolve(self, expression: str) -> Any:
        """Result of a promise."""
        found = self._call(
            "Runtime.evaluate", self._session, expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def memory(self, kind: str = "renderer") -> int:
        """Private memory in bytes of the browser's pages, or of its `GPU` process."""
        processes = self._call("SystemInfo.getProcessInfo")["processInfo"]
        kept = [
            Path(f"/proc/{process['id']}/smaps_rollup").read_text() for process in processes if process["type"] == kind
        ]
        return sum(
            int(line.split()[1]) << 10 for text in kept for line in text.splitlines() if line.startswith("Private")
        )

    def alive(self) -> dict[str, int]:
        """The browser's counts of objects in the page after a garbage collection, and bytes of the heap."""
        for method in (
            "HeapProfiler.enable",
            "HeapProfiler.collectGarbage",
            "Performance.enable",
        ):
            self._call(method, self._session)
        counted = self._call("Performance.getMetrics", self._session)["metrics"]
        return {one["name"]: one["value"] for one in counted if one["name"] in COUNTED}

    def drag(self, start: tuple[float, float], end: tuple[float, float], button: str = "left") -> None:
        held = {"left": 1, "right": 2}[button]
        self._mouse("mousePressed", *start, button=button, buttons=held, clickCount=1)
        for share in (0.25, 0.5, 0.75, 1.0):
            x, y = (a + (b - a) * share for a, b in zip(start, end, strict=True))
            self._mouse("mouseMoved", x, y, button=button, buttons=held)
        self._mouse("mouseReleased", *end, button=button, clickCount=1)

    def double_click(self, x: float, y: float) -> None:
        for count in (1, 2):
            for kind, held in (("mousePressed", 1), ("mouseReleased", 0)):
                self._mouse(kind, x, y, button="left", buttons=held, clickCount=count)

    def wheel(self, x: float, y: float, turn: float) -> None:
        self._mouse("mouseWheel", x, y, deltaX=0, deltaY=turn)

    def touch(self, *moments: list[tuple[float, float]]) -> None:
        """Touches the screen at a sequence of positions, then lifts the fingers."""
        for n, fingers in enumerate([*moments, []]):
            kind = "touchEnd" if not fingers else "touchMove" if n else "touchStart"
            points = [{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(fingers)]
            self._call("Input.dispatchTouchEvent", self._session, type=kind, touchPoints=points)

    def key(self, key: str) -> None:
        text = {"text": key} if len(key) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            self._call(
                "Input.dispatchKeyEvent", self._session, type=kind, key=key, **(text if kind == "keyDown" else {})
            )

    def _mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self._call("Input.dispatchMouseEvent", self._session, type=kind, x=x, y=y, **more)

    def emulate(self, width: int, height: int, *, touch: bool = False, **media: str) -> None:
        """Emulates a window size, touch in place of a mouse, and media features."""
        self._call(
            "Emulation.setDeviceMetricsOverride", self._session, width=width, height=height, deviceScaleFactor=1,
            mobile=touch,
        )  # fmt: skip
        self._call("Emulation.setTouchEmulationEnabled", self._session, enabled=touch)
        features = [{"name": name.replace("_", "-"), "value": value} for name, value in media.items()]
        self._call("Emulation.setEmulatedMedia", self._session, features=features)

    def screenshot(self) -> str:
        """A PNG in base 64."""
        return str(self._call("Page.captureScreenshot", self._session, format="png")["data"])

    def recorded(self, seconds: float, longest: float = 0.0) -> list[bytes]:
        """Records changes of the screen as PNG files for a while, longer if no picture has appeared."""
        frames: list[bytes] = []
        began = time.monotonic()
        self._call("Page.startScreencast", self._session, format="png")
        while (left := began + (seconds if frames else max(seconds, longest)) - time.monotonic()) > 0:
            if b"\0" not in self._connection.rest and not select.select([self._connection.source], [], [], left)[0]:
                break
            message = self._message()
            if message.get("method") == "Page.screencastFrame":
                frames.append(base64.b64decode(message["params"]["data"]))
                self._send("Page.screencastFrameAck", self._session, sessionId=message["params"]["sessionId"])
        self._call("Page.stopScreencast", self._session)
        return frames

    def timed_frames(self, url: str, quiet: float, least: float, most: float) -> list[tuple[float, float, bytes]]:
        """Opens an address and records changes of the screen: Unix time, processor time of the browser, JPEG file.

        Ends after `least` seconds once the picture has not changed for `quiet` seconds, at the latest after `most`.
        """
        frames: list[tuple[float, float, bytes]] = []
        asked: dict[int, int] = {}
        self._call("Page.startScreencast", self._session, format="jpeg", quality=90)
        began = changed = time.monotonic()
        self._send("Page.navigate", self._session, url=url)
        while (now := time.monotonic()) < began + most and (now < began + least or now < changed + quiet):
            if b"\0" not in self._connection.rest and not select.select([self._connection.source], [], [], 0.25)[0]:
                continue
            message = self._message()
            if message.get("id") in asked:
                place = asked.pop(message["id"])
                frames[place] = (frames[place][0], processor_seconds(message["result"]), frames[place][2])
            if message.get("method") == "Page.screencastFrame":
                shown = message["params"]
                frame = base64.b64decode(shown["data"])
                self._send("Page.screencastFrameAck", self._session, sessionId=shown["sessionId"])
                if not frames or frames[-1][2] != frame:
                    self._send("SystemInfo.getProcessInfo")
                    asked[self._connection.count] = len(frames)
                    frames.append((shown["metadata"]["timestamp"], 0.0, frame))
                    changed = time.monotonic()
        self._call("Page.stopScreencast", self._session)
        return frames

    def start_trace(self) -> None:
        """Starts a trace of the browser's threads."""
        wanted = {"includedCategories": ["toplevel", "devtools.timeline"], "recordMode": "recordAsMuchAsPossible"}
        self._call("Tracing.start", transferMode="ReturnAsStream", traceConfig=wanted)

    def trace_events(self) -> list[dict[str, Any]]:
        """Ends the trace and returns its events."""
        self._call("Tracing.end")
        while (message := self._message()).get("method") != "Tracing.tracingComplete":
            pass
        handle, text, ended = message["params"]["stream"], "", False
        while not ended:
            part = self._call("IO.read", handle=handle)
            text, ended = text + part["data"], part["eof"]
        return json.loads(text)["traceEvents"]

    def _send(self, method: str, session: str | None = None, **params: Any) -> None:
        self._connection.count += 1
        message = {"id": self._connection.count, "method": method, "params": params}
        if session:
            message["sessionId"] = session
        os.write(self._connection.out, json.dumps(message).encode() + b"\0")

    def _call(self, method: str, session: str | None = None, **params: Any) -> dict[str, Any]:
        self._send(method, session, **params)
        while True:
            answer = self._message()
            if answer.get("id") == self._connection.count:
                if error := answer.get("error"):
                    navigated = error["message"] in NAVIGATED
                    raise (NavigatedError if navigated else RuntimeError)(f"{method}: {error['message']}")
                return answer["result"]

    def _message(self) -> dict[str, Any]:
        pipes = self._connection
        while b"\0" not in pipes.rest:
            if not select.select([pipes.source], [], [], self.patience)[0]:
                raise TimeoutError("the browser says nothing")
            chunk = os.read(pipes.source, 1 << 16)
            if not chunk:
                raise RuntimeError("the browser is gone")
            pipes.rest += chunk
        data, _, pipes.rest = pipes.rest.partition(b"\0")
        return json.loads(data)


def processor_seconds(info: dict[str, Any]) -> float:
    """Processor time that all processes of the browser have used so far, seconds."""
    return float(sum(process["cpuTime"] for process in info["processInfo"]))


@contextlib.contextmanager
def browser() -> Iterator[Browser]:
    """Starts a browser with a fresh profile and ends it afterwards."""
    found = executable()
    assert found is not None
    theirs_in, ours_out = os.pipe()
    ours_in, theirs_out = os.pipe()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        words = [sys.executable, "-c", LAUNCH, str(theirs_in), str(theirs_out), found, *FLAGS]
        with running([*words, f"--user-data-dir={profile}"], pass_fds=(theirs_in, theirs_out)):
            os.close(theirs_in)
            os.close(theirs_out)
            try:
                yield Browser(Connection(ours_out, ours_in))
            finally:
                os.close(ours_out)
        os.close(ours_in)


_RUNNING = contextlib.ExitStack()
_SHARED: list[Browser] = []


@contextlib.contextmanager
def isolated_page() -> Iterator[Browser]:
    """Opens a page in the browser that this process starts once; the page finds nothing of earlier ones.

    After an error the next page starts another browser.
    """
    if not _SHARED:
        _SHARED.append(_RUNNING.enter_context(browser()))
    try:
        page = _SHARED[0].another()
        yield page
        page.forget()
        page.close()
    except BaseException:
        end_shared_browser()
        raise


def end_shared_browser() -> None:
    """Ends the browser of `isolated_page`, if there is one."""
    _SHARED.clear()
    _RUNNING.close()
