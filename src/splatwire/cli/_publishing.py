"""`splatwire serve --moq`: a stream goes to a relay, which sends it on."""

import sys
from pathlib import Path

from splatwire.cli._listening import stop_on_signals
from splatwire.cli._output import print_json
from splatwire.cli._receiving import TrustOptions


async def publish_stream(url: str, path: Path, trust: TrustOptions, *, json: bool) -> None:
    """Publishes a stream until somebody ends it.

    Args:
        url: https://RELAY[:PORT]/NAME.
        path: The stream.
        trust: Which relay is believed.
        json: Whether one JSON object says that it is ready.

    Raises:
        InvalidValueError: If the address is none, or no session comes about.
        BackendUnavailableError: If moq-rs is not installed.
    """
    from splatwire.errors import InvalidValueError
    from splatwire.packets import read_stream
    from splatwire.transport.address import parse_url
    from splatwire.transport.moq import need_moq, publish

    if not url.startswith(("https://", "moq://")):
        raise InvalidValueError(f"'{url}' is no relay such as https://RELAY/NAME")
    address = parse_url(f"moq://{url.partition('://')[2]}")
    need_moq()
    stream, _ = read_stream(path)
    stop = stop_on_signals()

    def ready() -> None:
        if json:
            print_json({"moq": url, "num_bytes": stream.num_bytes})
        else:
            print(f"publishing at moq://{address.host}:{address.port}/{address.name} (Ctrl-C ends it)")
        sys.stdout.flush()

    asked = await publish(address, stream, trust.relay_trust(), stop, ready)
    print(f"the relay asked for {asked.tracks:,} tracks, {asked.num_bytes:,} bytes", file=sys.stderr)
