"""Promises of every port about a wire that fails, and about a stop.

``python -m hilcell.conformance.wire_faults`` is a program that begins to move a device, to be
killed.
"""

from __future__ import annotations

import importlib
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import IO, Any, Self, cast

import msgspec

from hilcell.cell.file import Cell
from hilcell.cell.settings import convert
from hilcell.clock import WallClock
from hilcell.conformance.acts import ACTS, Driver, Port
from hilcell.conformance.trial import LOOK_S, Bench, Broken, Promises, Riding, Settings, fails, need
from hilcell.errors import DeviceError, Stopped
from hilcell.typed import Json, decoded

PROMISES = Promises()
STOP_S = 0.02
UNDER_WAY_S = 0.7
END_S = 10.0
STANDS_S = 0.3
# A device has seen by then that its client is gone; `travel` would have ended by then, too.
GONE_S = 5.0


class Task:
    """A call in a thread of its own."""

    def __init__(self, call: Callable[[], object]) -> None:
        self.error: Exception | None = None
        self.ended_s = 0.0
        self._call = call
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ended_within(self, limit_s: float) -> bool:
        self._thread.join(limit_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._call()
        except Exception as error:  # noqa: BLE001 - its caller judges it
            self.error = error
        self.ended_s = time.monotonic()


class Made(msgspec.Struct, frozen=True):
    """A driver's class and its options."""

    module: str
    name: str
    options: Json

    @classmethod
    def of(cls, settings: Settings, **changed: object) -> Self:
        """Return the order for one, with ``changed`` options."""
        kind, options = settings
        stated = msgspec.to_builtins(msgspec.structs.replace(options, **changed))
        return cls(kind.__module__, kind.__qualname__, stated)

    def built(self, table: str) -> Driver:
        """Return it, not connected."""
        kind: Any = importlib.import_module(self.module)
        for name in self.name.split("."):
            kind = getattr(kind, name)
        options = convert(self.options, kind.Options, table)
        return kind(options, WallClock(threading.Event()))


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """Which driver moves which device, and the robot on which it rides."""

    cell: Json
    port: Port
    driver: Made
    carrier: Made | None
    path: list[str]


class Child:
    """The program, from its start to its kill."""

    def __init__(self, bench: Bench) -> None:
        self._check = bench.clock.outer
        carrier = bench.carrier()
        order = Order(
            cell={k: v for k, v in msgspec.to_builtins(bench.cell).items() if v is not None},
            port=bench.port,
            driver=Made.of(bench.settings(), **bench.acts.slowly()),
            carrier=None if carrier is None else Made.of(carrier),
            path=sys.path,
        )
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "hilcell.conformance.wire_faults"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        stdin = cast("IO[bytes]", self._process.stdin)
        stdin.write(msgspec.json.encode(order) + b"\n")
        stdin.flush()

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *exception: object) -> None:
        self.kill()

    def wait_for(self, word: str) -> None:
        """Wait until it says a word; raises `Broken` where it ends before."""
        said_so = cast("IO[bytes]", self._process.stdout)
        while not select.select([said_so], [], [], LOOK_S)[0]:
            self._check()
        line = said_so.readline().decode().strip()
        if line != word:
            self._process.kill()
            said = self._process.communicate()[1].decode(errors="replace").strip()
            raise Broken(f"a program of its own could not use the device: {line} {said[-500:]}")

    def kill(self) -> None:
        """Kill it, as by ``kill -9``."""
        self._process.kill()
        self._process.communicate()


@PROMISES.add("silent", waits=True)
def silent(bench: Bench) -> None:
    """A device that answers no more is a DeviceError within 60 s."""
    driver = bench.connected()
    bench.acts.ask(driver)
    bench.wires.set("mute")
    began_s = time.monotonic()
    fails("no answer comes", lambda: bench.acts.ask(driver))
    took_s = time.monotonic() - began_s
    need(took_s <= 60.0, f"noticed after {took_s:.0f} s, expected <= 60 s")


@PROMISES.add("late", waits=True)
def late(bench: Bench) -> None:
    """A late answer never becomes the answer to the next question."""
    driver = bench.connected()
    bench.visit(driver, 0)
    bench.wires.set("hold")
    with suppress(DeviceError):  # `silent` judges that
        bench.acts.ask(driver)
    bench.wires.set("behind")
    try:
        reading = bench.acts.visit(driver, 1)
    except DeviceError:
        bench.wires.straight()
        driver.connect()
        bench.acts.ready(driver)
        reading = bench.acts.visit(driver, 1)
    bench.near(reading, 1)
    # A tracker's first request, its measurement, is kept back by itself.
    for requests in (1,) if bench.port == "tracker" else (0, 1):
        bench.tidy()
        _late_on_the_way(bench, requests)
    bench.tidy()
    _answered_again(bench)


def _answered_again(bench: Bench) -> None:
    """Have an old answer come once more, ahead of the right one, though the driver gave none up.

    Only its number, where the protocol has one, tells it from the right one.
    """
    driver = bench.connected()
    bench.acts.visit(driver, 0)
    bench.wires.set("keep")
    bench.acts.ask(driver)
    bench.wires.straight()
    question = partial(bench.acts.visit, driver, 1)
    if bench.port != "tracker":  # whose only question is a measurement
        question()
        question = partial(bench.acts.ask, driver)
    bench.wires.set("again")
    try:
        reading = question()
    except DeviceError:
        return  # it refuses
    bench.near(reading, 1)


def _late_on_the_way(bench: Bench, requests: int) -> None:
    """Do so with answers on the way to a place, after so many requests of the driver.

    The next question comes when all has ended, so an old answer does not happen to be right.
    """
    driver = bench.connected()
    bench.acts.visit(driver, 0)
    bench.wires.hold_after(requests)
    with suppress(DeviceError):
        bench.acts.visit(driver, 1)
    bench.clock.wait(30.0)  # a motion from place to place has ended
    bench.wires.set("behind")
    try:
        reading = bench.acts.ask(driver)
    except DeviceError:
        return  # it refuses
    bench.tidy()
    other = bench.build()
    other.connect()
    bench.rested(reading, bench.acts.ask(other), "an answer from before the question")


@PROMISES.add("slow")
def slow(bench: Bench) -> None:
    """Answers that come 50 ms late are as good as prompt ones."""
    driver = bench.connected()
    bench.wires.set("slow", delay_s=0.05)
    bench.visit(driver, 0)
    bench.visit(driver, 1)
    bench.acts.ask(driver)


@PROMISES.add("pieces")
def pieces(bench: Bench) -> None:
    """Answers that come in pieces, or together, are as good as whole ones."""
    driver = bench.connected()
    for mode in ("pieces", "glue"):
        bench.wires.set(mode)
        bench.visit(driver, 0)
        bench.visit(driver, 1)


@PROMISES.add("garbage", waits=True)
def garbage(bench: Bench) -> None:
    """Noise in place of an answer is a DeviceError."""
    driver = bench.connected()
    bench.wires.set("garbage")
    fails("noise comes", lambda: bench.acts.ask(driver))


@PROMISES.add("device-killed")
def device_killed(bench: Bench) -> None:
    """A device that was killed is a DeviceError; its successor connects."""
    driver = bench.connected()
    bench.replace_device()
    fails("the device was killed", lambda: bench.acts.ask(driver))
    driver.connect()
    bench.acts.ready(driver)
    bench.visit(driver, 0)


@PROMISES.add("client-killed", paced=True, waits=True)
def client_killed(bench: Bench) -> None:
    """A killed program's motion or measurement ends; the next program connects."""
    bench.present()
    ready = bench.connected()
    bench.acts.visit(ready, 0)
    ready.close()
    with Child(bench) as child:
        child.wait_for("connected")
        bench.rest(UNDER_WAY_S)
        child.kill()
    bench.rest(GONE_S)
    driver = bench.build()
    driver.connect()
    one = bench.acts.ask(driver)
    bench.rest(STANDS_S)
    bench.rested(one, bench.acts.ask(driver), "it goes on without its client")
    need(bench.acts.short(one), f"it went on to its target without its client, for {GONE_S:g} s")
    bench.acts.ready(driver)
    bench.visit(driver, 1)


@PROMISES.add("stop-at-once", paced=True)
def stop_at_once(bench: Bench) -> None:
    """Stop returns within 20 ms, from another thread."""
    took_s = []
    for _ in range(3):  # a busy PC may delay one of them
        driver, task = _under_way(bench)
        began_s = time.monotonic()
        driver.stop()
        took_s.append(time.monotonic() - began_s)
        bench.clock.stop.set()
        need(task.ended_within(END_S), f"the call goes on {END_S:.0f} s after the stop")
        bench.clock.stop.clear()
        driver.close()
        if took_s[-1] <= STOP_S:
            return
    best_ms = 1000 * min(took_s)
    need(min(took_s) <= STOP_S, f"stop took {best_ms:.0f} ms, expected <= {1000 * STOP_S:.0f} ms")


@PROMISES.add("stop-rests", "rail", "robot", paced=True)
def stop_rests(bench: Bench) -> None:
    """A stop ends the motion with a DeviceError; the device rests."""
    driver, task = _under_way(bench)
    driver.stop()
    need(task.ended_within(END_S), f"the motion does not end within {END_S:.0f} s of its stop")
    need(isinstance(task.error, DeviceError), f"the motion ended with {task.error!r} at its stop")
    driver.close()
    other = bench.build()
    other.connect()
    one = bench.acts.ask(other)
    bench.rest(STANDS_S)
    bench.rested(one, bench.acts.ask(other), "it still moves after its stop")


@PROMISES.add("stop-holds", "rail", "robot")
def stop_holds(bench: Bench) -> None:
    """After a stop nothing moves before the next connect."""
    bench.present()
    driver = bench.connected()
    driver.stop()
    fails("a motion after a stop", lambda: bench.acts.visit(driver, 1))


@PROMISES.add("checked")
def checked(bench: Bench) -> None:
    """Every wait on a wire ends within 20 ms of the run's stop."""
    took_s = []
    wakes_s = 0.005  # the system wakes a thread
    for pause_s in (0.05, 0.057, 0.064):  # before a stop: waits may be in step with it
        driver = bench.connected()
        bench.wires.set("mute")
        task = Task(partial(bench.acts.ask, driver))
        task.ended_within(pause_s)
        bench.clock.stop.set()
        began_s = time.monotonic()
        need(task.ended_within(END_S), f"it waits on for {END_S:.0f} s after the run's stop")
        need(isinstance(task.error, Stopped), f"it ended with {task.error!r}, expected Stopped")
        took_s.append(task.ended_s - began_s)
        bench.tidy()
        if took_s[-1] <= STOP_S + wakes_s:
            return
    best_ms = 1000 * min(took_s)
    prompt = min(took_s) <= STOP_S + wakes_s
    need(prompt, f"left after {best_ms:.0f} ms, expected <= {1000 * STOP_S:.0f} ms")


def _under_way(bench: Bench) -> tuple[Driver, Task]:
    """Begin what takes seconds."""
    bench.present()
    driver = bench.connected()
    bench.acts.visit(driver, 0)
    began_s = time.monotonic()
    task = Task(lambda: bench.acts.travel(driver))
    if task.ended_within(UNDER_WAY_S):
        took_s = task.ended_s - began_s
        how = "" if task.error is None else f", with {task.error!r}"
        wanted = f"wanted more than {UNDER_WAY_S:g} s, to be stopped meanwhile"
        raise Broken(f"{bench.acts.lasting} ended after {took_s:.2f} s{how}; {wanted}")
    return driver, task


def main() -> None:
    """Connect, say so, and begin what takes seconds."""
    order = decoded(sys.stdin.buffer.readline(), Order)
    sys.path[:] = order.path
    cell = convert(order.cell, Cell, "cell")
    device = order.driver.built(order.port)
    if order.carrier is not None:
        device = Riding(device, order.carrier.built("robot"))
    device.connect()
    print("connected", flush=True)
    ACTS[order.port](cell).travel(device)
    threading.Event().wait(30.0)


if __name__ == "__main__":
    main()
