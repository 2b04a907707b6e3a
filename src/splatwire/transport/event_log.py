"""Structured log events: a name with fields, as text or as JSON."""

import datetime
import json
import logging

_FIELDS = "splatwire_fields"


def log_event(logger: logging.Logger, level: int, event: str, **fields: str | int | float | bool) -> None:
    """Logs an event with its fields as one line of text, such as `transfer ended bytes=812 reason="left"`.

    Args:
        logger: Logger that receives the event.
        level: Level of the event, such as `logging.INFO`.
        event: Name of the event.
        **fields: Values of the event by name.
    """
    if logger.isEnabledFor(level):
        words = [event, *(f"{name}={json.dumps(value)}" for name, value in fields.items())]
        logger.log(level, "%s", " ".join(words), extra={_FIELDS: {"event": event, **fields}})


class RepeatedEvent:
    """Log of an event that may repeat many times: one line reports several events.

    Args:
        logger: Logger that receives the lines.
        event: Name of the event.
        interval_s: Minimum interval between two lines, seconds.
        min_count: Minimum number of events that one line reports.
    """

    def __init__(self, logger: logging.Logger, event: str, *, interval_s: float, min_count: int) -> None:
        self._logger, self._event, self._interval_s, self._min_count = logger, event, interval_s, min_count
        self._count, self._logged_at = 0, -interval_s

    def record(self, now: float) -> None:
        """Counts an event. If a line is due, logs the number of events since the last line as a warning.

        Args:
            now: Time, seconds.
        """
        self._count += 1
        if self._count >= self._min_count and now - self._logged_at >= self._interval_s:
            log_event(self._logger, logging.WARNING, self._event, count=self._count)
            self._count, self._logged_at = 0, now


class JsonFormatter(logging.Formatter):
    """Log formatter: one JSON object per line with time (UTC, RFC 3339), level, logger and the fields of the event."""

    def format(self, record: logging.LogRecord) -> str:
        """Returns a log record as one line of JSON."""
        fields = getattr(record, _FIELDS, None) or {"message": record.getMessage()}
        if record.exc_info:
            fields = {**fields, "traceback": self.formatException(record.exc_info)}
        head = {"time": _time(record), "level": record.levelname.lower(), "logger": record.name}
        return json.dumps({**head, **fields})


class TextFormatter(logging.Formatter):
    """Log formatter: one line of text with time (UTC, RFC 3339), level and message."""

    def format(self, record: logging.LogRecord) -> str:
        """Returns a log record as one line of text."""
        line = f"{_time(record)} {record.levelname} {' '.join(record.getMessage().split())}"
        return f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line


def _time(record: logging.LogRecord) -> str:
    time = datetime.datetime.fromtimestamp(record.created, datetime.UTC)
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")
