"""A headless Firefox, controlled by the Marionette protocol over a socket without further packages."""

import contextlib
import json
import os
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from browser_driver import NavigatedError, Page, running

NAVIGATED = (
    "Document was unloaded",
    "destroyed before query",
    "No such JSWindowActor",
    "Browsing context has been discarded",
)
"""Parts of the messages of calls in a document that another one replaced."""
PREFERENCES = """
user_pref("marionette.port", {port});
user_pref("browser.shell.checkDefaultBrowser", false);
user_pref("datareporting.policy.dataSubmissionEnabled", false);
user_pref("app.update.enabled", false);
user_pref("webgl.force-enabled", true);
"""


def executable() -> str | None:
    return shutil.which("firefox-esr") or shutil.which("firefox")


class Firefox(Page):
    """One page of a browser."""

    def __init__(self, port: int, seconds: float = 600.0) -> None:
        end = time.monotonic() + seconds
        while True:
            try:
                self._socket = socket.create_connection(("127.0.0.1", port), timeout=600)
                break
            except OSError:
                assert time.monotonic() < end, "Firefox did not start"
                time.sleep(0.2)
        self._rest, self._count = b"", 0
        self._message()  # greeting of the browser
        self._call("WebDriver:NewSession", {})
        self._call("WebDriver:SetTimeouts", {"script": 120_000, "pageLoad": 120_000})

    def open(self, url: str) -> None:
        self._call("WebDriver:Navigate", {"url": url})

    def evaluate(self, expression: str) -> Any:
        """Result of an expression or promise."""
        script = f"const tell = arguments[0]; Promise.resolve({expression}).then(tell, (error) => tell(String(error)));"
        found = self._call("WebDriver:ExecuteAsyncScript", {"script": script, "args": [], "sandbox": None})
        return found["value"]

    def screenshot(self) -> str:
        """A PNG in base 64."""
        return str(self._call("WebDriver:TakeScreenshot", {"full": False})["value"])

    def close(self) -> None:
        self._socket.close()

    def _call(self, name: str, fields: dict[str, Any]) -> Any:
        self._count += 1
        data = json.dumps([0, self._count, name, fields]).encode()
        self._socket.sendall(str(len(data)).encode() + b":" + data)
        _, number, error, found = self._message()
        assert number == self._count
        if error:
            navigated = any(words in str(error) for words in NAVIGATED)
            raise (NavigatedError if navigated else RuntimeError)(f"{name}: {error}")
        return found

    def _message(self) -> Any:
        while b":" not in self._rest:
            self._read()
        size, _, self._rest = self._rest.partition(b":")
        while len(self._rest) < int(size):
            self._read()
        data, self._rest = self._rest[: int(size)], self._rest[int(size) :]
        return json.loads(data)

    def _read(self) -> None:
        chunk = self._socket.recv(1 << 16)
        if not chunk:
            raise RuntimeError("the browser is gone")
        self._rest += chunk


@contextlib.contextmanager
def firefox() -> Iterator[Firefox]:
    """Starts a browser with a fresh profile and ends it afterwards."""
    found = executable()
    assert found is not None
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        (Path(profile) / "user.js").write_text(PREFERENCES.format(port=port))
        words = [found, "--headless", "--marionette", "--no-remote", "--profile", profile]
        with running(words, env={**os.environ, "HOME": profile}):
            page = Firefox(port)
            yield page
            page.close()
