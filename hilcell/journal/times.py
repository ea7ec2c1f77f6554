"""Times of day for people: in a zone of their own and in UTC, in which journals are dated."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone, tzinfo


def in_zone(t: str, zone: tzinfo | None = None) -> datetime:
    """Return a journal's time in a zone; None is that of this PC."""
    return datetime.fromisoformat(t).astimezone(zone)


def zone_of(offset_min: int) -> timezone:
    """Return the zone that is so many minutes ahead of UTC."""
    return timezone(timedelta(minutes=offset_min))


def offset_min() -> int:
    """Return by how many minutes the clock on this PC's wall is ahead of UTC now."""
    ahead = datetime.now(UTC).astimezone().utcoffset()
    return 0 if ahead is None else round(ahead.total_seconds() / 60)


def local_words(t: str, zone: tzinfo | None = None) -> str:
    """Return the time of day in a zone, which is named."""
    return f"{in_zone(t, zone):%H:%M:%S %Z}"


def time_words(t: str, zone: tzinfo | None = None) -> str:
    """Return the time of day with its zone, and in UTC where that is another."""
    ahead = in_zone(t, zone).utcoffset()
    return f"{local_words(t, zone)}, {t[11:19]} UTC" if ahead else local_words(t, zone)


def span_words(first: str, last: str, zone: tzinfo | None = None) -> str:
    """Return from when to when, to the second, with the zone, and in UTC where that is another."""
    begin, end = in_zone(first, zone), in_zone(last, zone)
    same_day = begin.date() == end.date()
    words = f"{begin:%Y-%m-%d %H:%M:%S} to {end:{'%H:%M:%S' if same_day else '%Y-%m-%d %H:%M:%S'}}"
    utc = f" ({first[11:19]} to {last[11:19]} UTC)" if begin.utcoffset() else ""
    return f"{words} {begin:%Z}{utc}"
