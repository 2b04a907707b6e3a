"""Updates that a server offers, prepared for sending."""

from collections.abc import Callable, Mapping

from splatwire.bitstream import SceneStream
from splatwire.transport import ServedStream


class OfferedUpdates:
    """Cache of scene updates that are prepared for sending, so that each update is prepared only once.

    Args:
        prepare: Function that prepares a stream for sending.
    """

    # Updates are distinguished as objects, not by name: if a scene returns to an earlier state, its next update has the
    # same name as one before, but other content.

    def __init__(self, prepare: Callable[[SceneStream], ServedStream]) -> None:
        self._prepare = prepare
        self._known: dict[int, tuple[SceneStream, ServedStream]] = {}

    def prepared(self, offers: Mapping[str, SceneStream | None]) -> dict[str, ServedStream | None]:
        """Returns the prepared updates by name; the value is None for an update that does not exist yet.

        Args:
            offers: Streams of all current updates by name; None for an update that does not exist yet.
        """
        updates = [update for update in offers.values() if update is not None]
        self._known = {id(update): self._known.get(id(update)) or (update, self._prepare(update)) for update in updates}
        return {name: None if update is None else self._known[id(update)][1] for name, update in offers.items()}
