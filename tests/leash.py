"""What a page of any browser can do once it evaluates expressions, and a browser's process."""

import contextlib
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any


class Page(ABC):
    """One page of a browser."""

    @abstractmethod
    def evaluate(self, expression: str) -> Any:
        """What an expression comes to."""

    def wait_for(self, expression: str, seconds: float = 60.0) -> Any:
        """Polls until it is neither undefined nor null nor false."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if value := self.evaluate(expression):
                return value
            time.sleep(0.05)
        raise TimeoutError(f"{expression} did not come true: {self.evaluate('document.body.innerText')}")


@contextlib.contextmanager
def running(words: Sequence[str], **more: Any) -> Iterator[None]:
    """Starts a program, and ends it."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **more)
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(15)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(15)
