"""Implementation of `splatwire transmit`: simulates packet loss on a stream."""

from splatwire.bitstream import read_stream, write_stream
from splatwire.channel import parse_loss, transmit
from splatwire.cli._files import input_path, output_path, refuse_own_input
from splatwire.cli._output import print_json, print_summary
from splatwire.cli.transmit import Transmit


def run(command: Transmit) -> None:
    """Runs `splatwire transmit`: simulates packet losses and writes the resulting stream."""
    loss = parse_loss(command.loss)
    refuse_own_input(command.output, command.stream)
    with input_path(command.stream) as source:
        sent, _ = read_stream(source)
    with output_path(command.output, expected_suffix=".swz", json=command.json) as path:
        received, record = transmit(sent, loss, seed=command.seed, send_order=command.send_order)
        write_stream(received, path)
    if command.json:
        print_json({"output": command.output, "num_bytes": received.num_bytes, **record.to_json()})
    else:
        text = f"{record.num_lost} of {record.num_sent} packets ({record.unit}) lost"
        elements = f"{record.num_lost_elements:,} of {record.num_sent_elements:,} {sent.manifest.elements}"
        print_summary(f"{text}, {elements} -> {command.output}", command.output)
