"""Waits until a key has done what it does, so that the next one finds the screen as it was meant.

Keys may come in bursts, from a scanner or over a thin link. A widget is told of a key by message,
and tells its screen by another; a key that overtook them would act on what was there before.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from contextlib import suppress

from textual.message_pump import MessagePump

LONGEST_S = 0.2  # a widget that is being removed may take nothing any more
BUILT_S = 2.0  # a screen that is left before it was built never is


async def settled(nodes: Iterable[MessagePump]) -> None:
    """Wait until each in turn has taken what it was sent; never for long."""
    for node in nodes:
        taken = asyncio.Event()
        if node.call_later(taken.set):
            await _soon(taken, LONGEST_S)


async def built(stands: asyncio.Event) -> None:
    """Wait until a screen stands; never for long, or no key would be taken any more."""
    await _soon(stands, BUILT_S)


async def _soon(event: asyncio.Event, limit_s: float) -> None:
    with suppress(TimeoutError):
        await asyncio.wait_for(event.wait(), limit_s)
