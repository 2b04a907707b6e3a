"""What the local page needs of streams that browsers do not decode, and of transfers from other servers."""

from splatwire.view.columns import columns_of
from splatwire.view.page import page_of_relay, page_of_stream
from splatwire.view.relay import Relay

__all__ = ["Relay", "columns_of", "page_of_relay", "page_of_stream"]
