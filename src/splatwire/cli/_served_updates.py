"""Updates of `splatwire serve --updates`: reads them from a folder and prepares the changed scenes for sending."""

import logging
import stat
import time
from collections.abc import Callable, Mapping, Set
from pathlib import Path
from typing import Any

from splatwire.api.offered_updates import OfferedUpdates
from splatwire.bitstream import SceneStream, read_stream
from splatwire.bitstream.limits import UPDATE
from splatwire.bitstream.sections import sections_of
from splatwire.codec.update.apply import check_base
from splatwire.codec.update.chain import UpdateChain
from splatwire.codec.update.section import SECTION, UpdateFields, manifest_digest, read_update, update_name
from splatwire.errors import BitstreamError, InvalidValueError, SplatwireError
from splatwire.transport import ServedStream
from splatwire.transport.event_log import log_event

LOG = logging.getLogger("splatwire.transport.serve")
PATIENCE_S = 3.0
"""Time without change after which an unreadable file is reported, seconds: until then it may still be written."""

Signature = tuple[int, int]
"""Time of the last change in nanoseconds, and size in bytes, of a file."""


def chains_of(streams: Mapping[str, tuple[SceneStream, SceneStream]]) -> dict[str, UpdateChain]:
    """Returns the update chains of all scenes that can be updated, by name of the scene.

    An update chain (`UpdateChain`) is the current state of a scene, with the latest updates to it.

    Args:
        streams: For each scene, by name: the stream as read from its file, and the same stream with packets that fit
            into datagrams.

    Raises:
        InvalidValueError: If no scene can be updated.
    """
    chains: dict[str, UpdateChain] = {}
    for name, (source, scene) in streams.items():
        try:
            check_base(source)
        except InvalidValueError as error:
            refused = error
        else:
            chains[name] = UpdateChain(source, scene)
    if not chains:
        raise refused
    return chains


class UpdateFolder:
    """Applies updates to served scenes when update files appear in a folder. Not thread-safe.

    An update changes one version of a scene to the next. An update file waits until a served scene has the version that
    the update changes.

    Args:
        folder: Folder with the updates, `.swz` files that `encode --update` wrote; it may be missing at first.
        chains: Scenes that can be updated, by name.
        prepare: Prepares a stream for sending.

    Attributes:
        updates: Prepared updates, by the name under which receivers request an update. The value is None for an update
            that does not exist yet.
    """

    # The order of the files does not matter. Scenes with equal content change together. While a file waits, only the
    # version that it changes is stored. A file that is removed is forgotten.

    def __init__(
        self, folder: Path, chains: Mapping[str, UpdateChain], prepare: Callable[[SceneStream], ServedStream]
    ) -> None:
        self._folder, self._chains, self._prepare = folder, dict(chains), prepare
        self._offered = OfferedUpdates(prepare)
        self._seen: dict[Path, tuple[Signature, float]] = {}
        self._read: dict[Path, Signature] = {}
        self._waiting: dict[Path, str] = {}
        self._reported: dict[Path, Signature] = {}
        self.updates: dict[str, ServedStream | None] = {}
        for chain in chains.values():
            self.updates |= dict.fromkeys(chain.offers())

    def poll(self, now: float | None = None) -> dict[str, ServedStream]:
        """Reads new files and applies their updates.

        Args:
            now: Current time, seconds; None to read the clock.

        Returns:
            The changed scenes, prepared for sending, by name.
        """
        now = time.monotonic() if now is None else now
        self._read_new(now)
        changed: dict[str, UpdateChain] = {}
        while next_update := self._next():
            names, path = next_update
            del self._waiting[path]
            try:
                update = _read_update(path)
                chains = {name: self._chains[name].extended(update) for name in names}
                self._check_distinct(chains)
            except (SplatwireError, OSError) as error:
                log_event(LOG, logging.ERROR, "update refused", file=str(path), error=str(error))
                continue
            self._chains |= chains
            changed |= chains
            for name, chain in chains.items():
                elements, size = chain.scene.manifest.num_elements, chain.updates[-1].num_bytes
                log_event(LOG, logging.INFO, "updated", stream=name, file=str(path), elements=elements, bytes=size)
        self._report_waiting(now)
        if changed:
            offers = {key: one for chain in self._chains.values() for key, one in chain.offers().items()}
            self.updates = self._offered.prepared(offers)
        return {name: self._prepare(chain.scene) for name, chain in changed.items()}

    def _report_waiting(self, now: float) -> None:
        """Logs a warning about updates that have waited for at least `PATIENCE_S` seconds, once for each file.

        Such an update may be for another scene or an earlier version.
        """
        old = {path: self._seen[path] for path in self._waiting if now - self._seen[path][1] >= PATIENCE_S}
        found = [path for path, (signature, _) in old.items() if self._reported.get(path) != signature]
        self._reported |= {path: old[path][0] for path in found}
        if found:
            log_event(
                LOG, logging.WARNING, "updates wait", file=str(found[0]), files=len(found),
                reason="no served scene has the version that they change",
            )  # fmt: skip

    def _next(self) -> tuple[list[str], Path] | None:
        """Finds an update file that can be applied now.

        Returns:
            Names of the scenes that the update changes, and the path of the file. None if no update can be applied.
        """
        states: dict[str, list[str]] = {}
        for name, chain in self._chains.items():
            states.setdefault(chain.source_digest, []).append(name)
        return next(((states[base], path) for path, base in self._waiting.items() if base in states), None)

    def _check_distinct(self, changed: Mapping[str, UpdateChain]) -> None:
        """Checks that no changed scene is equal to an earlier version of another served scene.

        Receivers request an update by the version that they have. If two scenes had an equal version, a receiver could
        get the update of the wrong scene. Only versions for which an update exists are checked.

        Args:
            changed: Scenes that the update changes, by name, each with the update applied.

        Raises:
            InvalidValueError: If two scenes would be equal.
        """
        # Receivers request the next update by the version that they have, and would get that of the other scene.
        reached = {update_name(manifest_digest(chain.scene.manifest)) for chain in changed.values()}
        for name, chain in self._chains.items():
            if name not in changed and any(chain.offers().get(each) is not None for each in reached):
                raise InvalidValueError(f"{' and '.join(changed)} would have the content that '{name}' had before")

    def _read_new(self, now: float) -> None:
        """Reads update files in the folder that are new or have changed."""
        present = sorted(self._folder.glob("*.swz"))
        for paths in (self._seen, self._read, self._waiting, self._reported):
            _forget_removed(paths, set(present))
        for path in present:
            try:
                status = path.stat()
            except OSError:  # removed meanwhile
                continue
            if not stat.S_ISREG(status.st_mode):  # reading a pipe would wait without end
                continue
            signature = status.st_mtime_ns, status.st_size
            if self._read.get(path) == signature:
                continue
            before, since = self._seen.get(path, (None, now))
            since = since if before == signature else now
            self._seen[path] = signature, since
            try:
                base = _fields_of(_read_update(path)).base_digest
            except (SplatwireError, OSError) as error:
                if now - since >= PATIENCE_S:
                    self._read[path] = signature
                    log_event(LOG, logging.ERROR, "update refused", file=str(path), error=str(error))
                continue
            self._read[path], self._waiting[path] = signature, base


def _forget_removed(paths: dict[Path, Any], present: Set[Path]) -> None:
    for path in paths.keys() - present:
        del paths[path]


def _read_update(path: Path) -> SceneStream:
    """Reads the file of an update.

    Raises:
        BitstreamError: If the file is damaged or incomplete, or is not an update.
        OSError: If the file cannot be read.
    """
    update = read_stream(path)[0]
    if update.manifest.schema_name != UPDATE:
        raise BitstreamError(f"the stream has {update.manifest.elements}, it is not an update")
    if len(update.packets) < update.manifest.num_packets:
        raise BitstreamError("packets of the update are missing")
    _fields_of(update)
    return update


def _fields_of(update: SceneStream) -> UpdateFields:
    return read_update(sections_of(update).get(SECTION, b""))
