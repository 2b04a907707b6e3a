"""`python -m splatwire` is the command `splatwire`."""

from splatwire.cli.main import main

if __name__ == "__main__":
    main()
