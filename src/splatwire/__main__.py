"""`python -m splatwire` is the command `splatwire`."""

import importlib
import sys


def start() -> None:
    """Loads the command line and runs it with the arguments of this process.

    Ctrl-C while it loads ends the process like Ctrl-C later, with exit status 130 and without a traceback.
    """
    try:
        importlib.import_module("splatwire.cli.main").main()
    except KeyboardInterrupt:
        if sys.stderr is not None:
            sys.stderr.write("splatwire: stopped\n")
        sys.exit(130)


if __name__ == "__main__":
    start()
