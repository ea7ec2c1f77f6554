"""Work that waits, in a thread of its own: neither keys nor the end of the screen wait for it.

asyncio's own threads are joined when a program ends; an engine that works for an hour, or one that
does not answer, would hold a screen that was left.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


async def aside(work: Callable[P, T], *args: P.args, **facts: P.kwargs) -> T:
    """Return what a function returns, or raise what it raises."""
    future: Future[T] = Future()

    def run() -> None:
        future.set_running_or_notify_cancel()
        try:
            future.set_result(work(*args, **facts))
        except Exception as error:  # noqa: BLE001 - raised where it is awaited
            future.set_exception(error)

    threading.Thread(target=run, name="aside", daemon=True).start()
    return await asyncio.wrap_future(future)
