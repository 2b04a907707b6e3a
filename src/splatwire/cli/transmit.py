"""`splatwire transmit`: a stream loses packets."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from splatwire.cli._files import input_path, output_path
from splatwire.cli._output import JsonFlag, print_json, print_summary


@dataclass(frozen=True)
class Transmit:
    """Send a stream through a channel that loses packets."""

    stream: tyro.conf.Positional[str]
    """Stream: a .swz file, a folder, or - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Stream to write: one file if it ends in .swz (or is -), a folder of packets otherwise."""
    loss: str = "bernoulli:0.2"
    """What is lost: none, bernoulli:RATE, gilbert:RATE,BURST, gilbert:PRESET or trace:FILE; the unit is a .pak."""
    seed: int = 0
    """Seed of the losses."""
    send_order: str = "interleaved"
    """interleaved: lane by lane, so that a burst hits many blocks; block: block by block; tiers: tier by tier."""
    accept_damage: bool = False
    """Exit with status 0 although bytes of the stream are damaged; packets that are only missing need no option."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.channel import parse_loss, transmit
        from splatwire.packets import read_stream, write_stream

        loss = parse_loss(self.loss)
        with input_path(self.stream) as source:
            sent, _ = read_stream(source)
        with output_path(self.output, suffix=".swz", json=self.json) as path:
            received, record = transmit(sent, loss, seed=self.seed, send_order=self.send_order)
            write_stream(received, path)
        if self.json:
            print_json({"output": self.output, "num_bytes": received.num_bytes, **record.to_json()})
        else:
            text = f"{record.num_lost} of {record.num_sent} packets ({record.unit}) lost"
            elements = f"{record.num_lost_elements:,} of {record.num_sent_elements:,} {sent.manifest.elements}"
            print_summary(f"{text}, {elements} -> {self.output}", self.output)
