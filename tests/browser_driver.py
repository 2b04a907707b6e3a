"""Control of a browser process and its pages by evaluated expressions."""

import contextlib
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any


class NavigatedError(RuntimeError):
    """An expression has no result because another document replaced the one in which it was evaluated."""


class Page(ABC):
    """A page of a browser."""

    @abstractmethod
    def evaluate(self, expression: str) -> Any:
        """Result of an expression."""

    def wait_for(self, expression: str, seconds: float = 600.0) -> Any:
        """Evaluates a JavaScript expression again and again until its result is true, also across navigations."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            with contextlib.suppress(NavigatedError):
                if value := self.evaluate(expression):
                    return value
            time.sleep(0.05)
        raise TimeoutError(f"{expression} did not come true: {self.evaluate('document.body.innerText')}")


@contextlib.contextmanager
def running(words: Sequence[str], **more: Any) -> Iterator[None]:
    """Starts a program and ends it afterwards."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **more)
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(15)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(120)
