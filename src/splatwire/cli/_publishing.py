"""`splatwire serve --moq`: publishes a stream to a Media-over-QUIC relay, which forwards it to subscribers."""

import sys
from pathlib import Path

from splatwire.bitstream import read_stream
from splatwire.cli._listening import stop_on_signals
from splatwire.cli._options import TrustOptions
from splatwire.cli._output import print_json
from splatwire.cli._receiving import relay_trust
from splatwire.cli._terminal import one_line
from splatwire.errors import InvalidValueError
from splatwire.transport.address import parse_url
from splatwire.transport.moq.publisher import need_moq, publish
from splatwire.transport.protocol.receiver_options import check_stream_name


async def publish_stream(url: str, path: Path, trust: TrustOptions, *, json: bool) -> None:
    """Publishes a stream to a relay until the process is stopped.

    Args:
        url: Address of the relay and name of the broadcast: https://RELAY[:PORT][/PATH]/NAME.
        path: Path of the stream.
        trust: Options that determine which relay certificates are accepted.
        json: True to print a JSON object when the relay is connected.

    Raises:
        InvalidValueError: If the address is invalid, or the connection to the relay fails.
        BackendUnavailableError: If moq-rs is not installed.
    """
    if not url.startswith(("https://", "moq://")):
        raise InvalidValueError(f"'{url}' is no relay such as https://RELAY/NAME")
    address = parse_url(f"moq://{url.partition('://')[2]}")
    check_stream_name(address.name)  # receivers refuse others
    need_moq()
    stream = read_stream(path)[0].require_scene(path)

    def ready() -> None:
        if json:
            print_json({"moq": url, "num_bytes": stream.num_bytes})
        else:
            print(f"publishing at {address.url} (Ctrl-C ends it)")
        sys.stdout.flush()

    def warn(text: str) -> None:
        print(f"splatwire: warning: {one_line(text)}", file=sys.stderr, flush=True)

    with stop_on_signals() as stop:
        requested = await publish(address, stream, relay_trust(trust), stop, ready, warn)
    print(f"the relay asked for {requested.tracks:,} tracks, {requested.num_bytes:,} bytes", file=sys.stderr)
