"""A KUKA robot through EthernetKRL: commands and states as XML documents, see `drivers.kuka.eki`.

The controller is the server of two channels. Its submit program ``eki_krl/hilcell_eki.src`` answers
each command of the first with its state, also while the robot moves or its program is halted, and
brakes by the second; motions are made by ``krl/hilcell.src``, as with `drivers.kuka.robot_c3`.
The commands of the thread that watches a motion are signs of life.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

from drivers.kuka import eki, krl
from drivers.kuka.controller import (
    PROGRAM_VERSION,
    PROGRESS,
    integer,
    override_held,
    unreadable,
)
from drivers.kuka.external import SlidingKukaRobot
from drivers.kuka.health import HEALTH, LIFE_S, SLIDE
from drivers.kuka.robot import KukaOptions
from drivers.robot_errors import DEVICE
from drivers.supervision import Patience, go_on, on_failure
from drivers.wires.keep_alive import KeepAlive
from drivers.wires.tcp import POLL_S, Alarms, TcpLink
from hilcell.clean import clean
from hilcell.ports import Array, Clock, DeviceError
from hilcell.wire.channel import Port

# An answer to an earlier command may come late, or before the one that is awaited: it is never
# used. The controller serves one client a channel and opens it again a moment after a client has
# gone, so connecting is tried for a while.

DOCUMENTS_VERSION = 1
ANSWER_S = 2.0
OPEN_S = 3.0  # the channel of a client that has gone is open again
AGAIN = 5  # times POLL_S from one try to the next
RECEIVE = 4096
ALARMS = Alarms(unreachable="HC-B01", lost="HC-B02")


class EkiChannel:
    """One connection, one command in flight; a lock lets a keep-alive share it."""

    def __init__(
        self, device: str, host: str, port: int, root: str, attend: Callable[[], None]
    ) -> None:
        """``root`` is that of the answers; ``attend`` runs in every wait."""
        self.attend = attend
        self._device, self._root = device, root
        self._link = TcpLink(device, host, port, self._attend, ALARMS)
        self._lock = threading.Lock()
        self._received = b""
        self._dead = ""
        self.used_s = time.monotonic()

    def ask(self, number: int, document: bytes) -> eki.State:
        """Send a command and return its answer; raises `DeviceError`."""
        operation = f"motion {number}" if number > 0 else "command"
        with self._lock:
            if self._dead:
                raise self._link.broken(operation, self._dead)
            self._link.send(document, operation)
            state = self._answer(number, operation)
            self.used_s = time.monotonic()
        return state

    def send_unheard(self, document: bytes, patience_s: float = 0.05) -> None:
        """Send without waiting for the answer; a command in flight may end first."""
        held = self._lock.acquire(timeout=patience_s)
        self._link.unheard = True
        try:
            self._link.send(document, "stop")
        finally:
            if held:
                self._lock.release()

    def close(self) -> None:
        """Close the connection."""
        self._link.close()

    def _attend(self) -> None:
        self.attend()

    def _answer(self, number: int, operation: str) -> eki.State:
        patience, others = Patience(ANSWER_S), 0
        while True:
            for found, state in self._documents(operation):
                if found == number:
                    return state
                others += 1
            piece = self._link.receive(RECEIVE, patience)
            if not piece:
                passed = f"; {others} answers to other commands came" if others else ""
                started = f"; {len(self._received)} bytes of one came" if self._received else ""
                raise self._link.broken(
                    operation, f"no answer within {ANSWER_S:.1f} s{passed}{started}"
                )
            self._received += piece

    def _documents(self, operation: str) -> list[tuple[int, eki.State]]:
        """Take the whole documents out of what was received; an unusable one ends the use."""
        try:
            whole, self._received = eki.split(self._received, self._root)
            return [eki.parse(document, self._root) for document in whole]
        except eki.EkiError as error:
            self._dead = str(error)
            raise DeviceError(
                "HC-B49",
                self._device,
                operation,
                f"{self._link.address}: {error}",
                wanted=f"a document <{self._root}>",
                act="is this the port of hilcell's channel? see docs/hardware.md",
                fields={"address": self._link.address},
            ) from error


def open_channel(
    device: str, host: str, port: int, root: str, attend: Callable[[], None], probe: bytes
) -> EkiChannel:
    """Return a channel that has answered ``probe``, of Id 0; raises `DeviceError`."""
    patience, over = Patience(OPEN_S, OPEN_S), False
    while True:
        channel = None
        try:
            channel = EkiChannel(device, host, port, root, attend)
            channel.ask(0, probe)
        except BaseException as error:
            if channel is not None:
                channel.close()
            if over or not isinstance(error, DeviceError):
                raise
        else:
            return channel
        over = patience.over()
        for _ in range(AGAIN):
            attend()
            time.sleep(POLL_S)


LARGEST_ID = 1_000_000_000
LIFE_MS = round(1000 * LIFE_S)


class EkiController:
    """Satisfies `drivers.kuka.controller.SlidingController`; a look is an exchange of documents."""

    measured = "$AXIS_ACT_MEAS"
    rounds = ((*HEALTH, "$OV_PRO", PROGRESS),)
    ready = (*HEALTH, "$OV_PRO", "$ACT_TOOL", "$ACT_BASE")  # one document has them all

    def __init__(self, options: KukaEkiRobot.Options, robot: SlidingKukaRobot) -> None:
        self.address = f"{options.host}:{options.port}"
        self.versions = {"HC_VER": PROGRAM_VERSION, "HE_VER": DOCUMENTS_VERSION}
        opened = partial(open_channel, DEVICE, options.host)
        # Answers to an earlier session must not pass for answers to this one.
        self._number = -1 - secrets.randbelow(LARGEST_ID)
        self._state: eki.State | None = None
        self._life_ms = 0
        probe, stop_probe = eki.command(0, eki.Kind.ASK), eki.stop_command(0, brake=False)
        self._line = opened(options.port, eki.STATE, robot.attend, probe)
        with on_failure(self._line.close):
            # The stop must get through while the run is already stopping.
            self._stop_line = opened(options.stop_port, eki.STOPPED, go_on, stop_probe)
        self._keeper = KeepAlive(
            (self._stop_line,), lambda line: line.ask(0, eki.stop_command(0, brake=False))
        )

    def look(self) -> None:
        """Forget the last state, so that the next value asks for one."""
        self._state = None

    def value(self, name: str) -> krl.Value:
        """Return a single value of the state."""
        try:
            return self._known().single(name)
        except (eki.EkiError, krl.KrlError) as error:
            raise unreadable(name, error) from error

    def numbers(self, name: str, components: tuple[str, ...]) -> list[float]:
        """Return components of a structure of the state."""
        try:
            return self._known().numbers(name, components)
        except (eki.EkiError, krl.KrlError) as error:
            raise unreadable(name, error) from error

    def text(self, name: str) -> str:
        """Return a text of the state."""
        try:
            return clean(self._known().text(*eki.SINGLE[name]).strip())
        except eki.EkiError as error:
            raise unreadable(name, error) from error

    def start(self, number: int, target_deg: Array, speed_percent: int) -> None:
        """Send a motion; the Id of its document is its number."""
        axes, e1 = target_deg[:6].tolist(), float(sum(target_deg[6:]))
        self._start(number, eki.Kind.MOVE, speed_percent, axes=axes, e1=e1)

    def start_slide(self, number: int, place_mm: float, speed_percent: int) -> None:
        """Send a motion of E1 alone."""
        self._start(number, eki.Kind.MOVE_SLIDE, speed_percent, e1=place_mm)

    def has_slide(self) -> bool:
        """Whether the controller counts an external axis."""
        return integer(self, "$EX_AX_NUM") > 0

    def mastered(self) -> bool:
        """Whether E1 is mastered."""
        return self.value("$AXIS_JUS[7]") is True

    def hold_slide(self, held: bool) -> None:
        """Send whether E1 may move."""
        self._send(eki.Kind.HOLD_SLIDE if held else eki.Kind.FREE_SLIDE)

    def slide(self) -> tuple[float, bool]:
        """Return where E1 is, and whether it is held, of one state."""
        (place_mm,) = self.numbers(PROGRESS, (SLIDE,))
        return place_mm, self.value("HC_HELD") is True

    def sign(self) -> None:
        """Have the next command be a sign of life; others are none, so that a motion brakes whose
        engine has died while this one asks for states.
        """
        self._life_ms = LIFE_MS

    def brake(self) -> None:
        """Send a stop over the channel of commands."""
        self._send(eki.Kind.BRAKE)

    def release(self) -> None:
        """Send that the stop is over, where there is one."""
        if self.value("HC_STOP") is not False:
            self._send(eki.Kind.RELEASE)

    def lower_override(self, found: int, wanted: int) -> None:
        """Have the controller keep the old value and set the new one."""
        self._send(eki.Kind.LOWER, wanted)
        override_held(integer(self, "$OV_PRO"), wanted)

    def give_back_override(self) -> None:
        """Have the controller set the old value, where nobody has changed the lowered one."""
        self._send(eki.Kind.GIVE_BACK)

    def lowered_override(self) -> bool:
        """Whether the controller keeps an old value."""
        return integer(self, "HC_OV_OLD") != 0

    @contextmanager
    def undisturbed(self) -> Iterator[EkiController]:
        """Let a stop through for a while: the controller serves one client only."""
        attend, self._line.attend = self._line.attend, go_on
        try:
            yield self
        finally:
            self._line.attend = attend

    def stop(self) -> None:
        """Send the stop over its own channel."""
        self._stop_line.send_unheard(eki.stop_command(1, brake=True))

    def check(self) -> None:
        """Raise what the keep-alive has found."""
        self._keeper.check()

    def close(self) -> None:
        """Close both channels."""
        self._keeper.close()
        for line in (self._line, self._stop_line):
            line.close()

    def _known(self) -> eki.State:
        return self._state or self._send(eki.Kind.ASK)

    def _start(
        self,
        number: int,
        kind: eki.Kind,
        percent: int,
        *,
        axes: Sequence[float] = (0.0,) * 6,
        e1: float = 0.0,
    ) -> None:
        motion = eki.command(number, kind, axes=axes, e1=e1, percent=percent, life_ms=LIFE_MS)
        self._state = self._line.ask(number, motion)

    def _send(self, kind: eki.Kind, percent: int = 1) -> eki.State:
        self._number = -1 - (-self._number) % LARGEST_ID
        life_ms, self._life_ms = self._life_ms, 0
        document = eki.command(self._number, kind, percent=percent, life_ms=life_ms)
        self._state = self._line.ask(self._number, document)
        return self._state


class KukaEkiRobot(SlidingKukaRobot):
    """Satisfies `hilcell.ports.Robot`, `hilcell.ports.Sweeps` and `hilcell.ports.ExternalAxis`."""

    class Options(KukaOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Address and wanted identity of the controller."""

        port: Port = 54600
        stop_port: Port = 54601

        def __post_init__(self) -> None:
            if self.port == self.stop_port:
                raise ValueError(f"stop_port: {self.stop_port} is that of port, too; they differ")

    def __init__(self, options: Options, clock: Clock) -> None:
        super().__init__(options, clock, partial(EkiController, options))
