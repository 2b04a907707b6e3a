"""`python -m splatwire` is the command `splatwire`."""

import contextlib
import importlib
import signal
import sys


def start() -> None:
    """Loads the command line and runs it with the arguments of this process.

    Ctrl-C has the same effect during loading as at any later time: the process ends with exit status 130 and without a
    traceback.
    """
    try:
        importlib.import_module("splatwire.cli.main").main()
    except KeyboardInterrupt as error:
        if sys.stderr is not None:
            with contextlib.suppress(OSError):  # its reader has exited, or the disk is full
                sys.stderr.write("splatwire: stopped\n")
                sys.stderr.flush()
        sys.exit(128 + getattr(error, "number", signal.SIGINT))


if __name__ == "__main__":
    start()
