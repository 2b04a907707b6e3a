"""Local web page of `splatwire view`."""

from splatwire.view.page import page_of_relay, page_of_stream
from splatwire.view.relay import Relay

__all__ = ["Relay", "page_of_relay", "page_of_stream"]
