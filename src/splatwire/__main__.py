"""`python -m splatwire` is the command `splatwire`."""

import importlib
import sys


def start() -> None:
    """Loads the command line and runs it with the arguments of this process.

    Ctrl-C while it loads ends the process like Ctrl-C later, with exit status 130 and without a traceback.
    """
    try:
        command_line = importlib.import_module("splatwire.cli.main")
    except KeyboardInterrupt:
        sys.stderr.write("splatwire: stopped\n")
        sys.exit(130)
    command_line.main()


if __name__ == "__main__":
    start()
