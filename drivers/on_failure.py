"""Take back a beginning whose rest fails, whatever the failure is: a wire, a motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def on_failure(take_back: Callable[[], None]) -> Iterator[None]:
    """Call ``take_back`` where the body raises, a stop included; the error goes on."""
    try:
        yield
    except BaseException:  # also a stop or Ctrl-C: no wire and no motion is left behind
        take_back()
        raise
