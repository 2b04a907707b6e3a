"""Implementation of `splatwire token`: prints a signed token."""

from splatwire.cli._output import print_json
from splatwire.cli.token import Token
from splatwire.transport.http.tokens import make_token, read_key


def run(command: Token) -> None:
    """Runs `splatwire token`: prints a signed token that opens private scenes."""
    token = make_token(read_key(command.key), command.scenes, command.hours * 3600)
    if command.json:
        print_json({"token": token, "scenes": list(command.scenes), "hours": command.hours})
    else:
        print(token)
