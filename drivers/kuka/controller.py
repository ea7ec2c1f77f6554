"""The wire to a KUKA controller and its program hilcell, and their common states.

During a motion the program ``hilcell.src`` runs a timer of the controller up to zero; there it
brakes, latches like HC_STOP, and drops the command. The PC sets the timer back with each heartbeat,
from the thread that supervises the motion only: an engine that hangs sends none.

The trap: KUKAVARPROXY drops a client after 30 s without a request, and a stop sent over a dropped
connection is lost. So a thread sends a harmless request over idle connections.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Literal, Protocol

from drivers.device_errors import ROBOT
from drivers.kuka import krl
from drivers.kuka.krl import POSE
from drivers.wires import TcpLink
from hilcell.ports import Array, DeviceError, HilcellError, Stopped

PROGRESS = "$AXIS_ACT"
PROGRAM_VERSION = 4  # of hilcell.src


class ControllerLink:
    """One connection, one request in flight; a lock lets a keep-alive share it."""

    def __init__(self, host: str, port: int, check: Callable[[], None]) -> None:
        """``check`` runs in every wait; `check_wait` may be replaced for a while."""
        self.check_wait = check
        self._link = TcpLink(ROBOT, host, port, self._check_wait)
        self._lock = threading.Lock()
        self._received = b""
        self._dead = ""  # why no request may be made any more
        self.used_s = time.monotonic()

    def _check_wait(self) -> None:
        self.check_wait()

    @contextmanager
    def _in_flight(self, operation: str) -> Iterator[None]:
        """Take the connection for one request and its answer; raises `DeviceError`."""
        with self._lock:
            if self._dead:
                raise self._link.broken(operation, self._dead)
            yield
            self.used_s = time.monotonic()

    @contextmanager
    def _unheard(self) -> Iterator[None]:
        """Take the connection for a request whose reply is not awaited.

        A request in flight gets a moment to end, because some servers lose a second one that
        arrives in the same segment; then the bytes are sent anyway.
        """
        held = self._lock.acquire(timeout=0.05)
        self._link.reply_pending = True
        try:
            yield
        finally:
            if held:
                self._lock.release()

    def keep_alive(self) -> None:
        """Ask something harmless; raises `DeviceError`."""
        raise NotImplementedError

    def close(self) -> None:
        self._link.close()


@dataclass(frozen=True, slots=True)
class Need:
    """A variable that the driver uses; ``otherwise`` says what follows where there is none."""

    variable: str
    otherwise: str = ""
    needed: Literal["mandatory", "optional"] = "mandatory"


class Controller(Protocol):
    """The open wires to one controller: its variables by their names, motions, and the stop."""

    address: str
    versions: dict[str, int]  # what must be installed: the number of each
    needs: Sequence[Need]
    _line: ControllerLink
    _stop_line: ControllerLink
    _keeper: KeepAlive

    @property
    def poll_groups(self) -> Sequence[tuple[str, ...]]:
        """The variables to read while moving: each poll of a motion reads the next group."""

    @property
    def motion_checks(self) -> tuple[str, ...]:
        """The variables to check before a motion is ordered."""

    @property
    def joints_variable(self) -> str:
        """The variable of the measured joints, or of the ordered ones where there is none."""

    def refresh(self) -> None:
        """Values that are read next must be newer than this call."""

    def has(self, name: str) -> bool:
        """Whether the controller lets a variable be read."""

    def value(self, name: str) -> krl.Value: ...

    def numbers(self, name: str, components: tuple[str, ...]) -> list[float]: ...

    def text(self, name: str) -> str:
        """Return a text, cleaned."""

    def found(self, name: str) -> str | None:
        """Return what the controller has under a variable's name, cleaned; None for nothing."""

    def limits(self, names: tuple[str, ...]) -> list[tuple[float, float]] | None:
        """Return the software limits of axes, deg or mm; None where they cannot be read."""

    def tool(self, number: int) -> list[float] | None:
        """Return X, Y, Z, A, B, C of a tool; None where it cannot be read."""

    def start(self, number: int, target_deg: Array, speed_percent: int) -> None:
        """Hand a motion to joints (6,) over; a held slide's place (mm) may follow (7,)."""

    def start_slide(self, number: int, place_mm: float, speed_percent: int) -> None:
        """Hand a motion of E1 alone over."""

    def heartbeat(self) -> None:
        """Send the program a heartbeat, if one is due."""

    def hold_slide(self, held: bool) -> None:
        """Have the program refuse every motion of E1, or allow it."""

    def slide(self) -> tuple[float, bool]:
        """Return where E1 is in mm, and whether it is held."""

    def brake(self) -> None:
        """Stop the robot; return when the program has acknowledged it."""

    def end_brake(self) -> None:
        """Reset the stop in the program."""

    def lower_override(self, found: int, expected: int) -> None:
        """Lower $OV_PRO so that the controller itself knows its old value."""

    def restore_override(self) -> None:
        """Restore an override that was lowered, unless it has been changed meanwhile. The robot
        must be at rest.
        """

    def ignoring_stop(self) -> AbstractContextManager[Controller]:
        """Return a controller whose waits a stop does not end."""

    def stop(self) -> None:
        """Brake; any thread; waits for no answer."""

    def integer(self, name: str) -> int:
        """Return a whole number that the controller has; raises `DeviceError`."""
        value = self.value(name)
        if isinstance(value, bool) or not isinstance(value, int):
            raise value_error(name, f"expected a whole number, got {value!r}")
        return value

    def release(self) -> None:
        """Reset a stop, where there is one; nothing moves by it."""
        if self.value("HC_STOP") is not False:
            self.end_brake()

    def has_lowered_override(self) -> bool:
        """Whether a lowered override is still to be restored."""
        return self.integer("HC_OV_OLD") != 0

    def check_override(self, expected: int) -> None:
        """Raise `DeviceError` where the override is not what was ordered."""
        if (found := self.integer("$OV_PRO")) != expected:
            raise ROBOT.failed(
                "HC-B40",
                "sweep",
                f"$OV_PRO is {found}",
                expected=f"{expected}",
                override=found,
                wanted_override=expected,
            )

    def has_slide(self) -> bool:
        return self.has("$EX_AX_NUM") and self.integer("$EX_AX_NUM") > 0

    def is_mastered(self) -> bool:
        """Whether E1 is mastered; True where the controller has no such variable."""
        return not self.has("$AXIS_JUS[7]") or self.value("$AXIS_JUS[7]") is True

    def check(self) -> None:
        """Raise the error of a wire that failed while it was idle."""
        self._keeper.check()

    def close(self) -> None:
        self._keeper.close()
        for line in (self._line, self._stop_line):
            line.close()


def value_error(name: str, found: object) -> DeviceError:
    return ROBOT.failed("HC-B26", f"read {name}", str(found), variable=name)


@contextmanager
def value_errors(name: str) -> Iterator[None]:
    """Raise `DeviceError` for an invalid value."""
    try:
        yield
    except ValueError as error:
        raise value_error(name, error) from error


LOST, STOPPED = 8, 9  # HC_ERR
# Text of HC_ERR, and its alarm.
ERRORS = {
    1: ("unknown command", "HC-B20"),
    2: ("target outside the software limits", "HC-B20"),
    3: ("external axis E1 has left the place at which it is held", "HC-R52"),
    4: ("external axis E1 is held", "HC-B20"),
    5: ("external axis E1 is not held, so the arm stays", "HC-B20"),
    LOST: ("the PC's life sign was late, and the robot has braked by itself", "HC-B43"),
    STOPPED: ("stopped by HC_STOP", "HC-B21"),
}

# Variable, its valid values, the alarm of any other; causes first.
HEALTH: dict[str, tuple[tuple[str | bool, ...], str]] = {
    "$ALARM_STOP": ((True,), "HC-B10"),
    "$USER_SAF": ((True,), "HC-B11"),
    "$MODE_OP": (("#EX", "#AUT"), "HC-B12"),
    "$PERI_RDY": ((True,), "HC-B13"),
    "$STOPMESS": ((False,), "HC-B14"),
    "$PRO_STATE1": (("#P_ACTIVE",), "HC-B15"),
}


NEEDS = (
    *(Need(name) for name in ("$TRAFONAME[]", "$KR_SERIALNO", *HEALTH, "$OV_PRO")),
    *(
        Need(name, "has no value before hilcell.src was started")
        for name in ("$ACT_TOOL", "$ACT_BASE", "$TOOL", "$BASE", "$POS_ACT")
    ),
    *(
        Need(name, "hilcell.src and hilcell.dat are not installed, or the server does not see them")
        for name in (
            "HC_VER", "HC_SEQ", "HC_ACK", "HC_ERR", "HC_STOP", "HC_OV_OLD", "HC_HELD",
        )
    ),
    Need("$AXIS_ACT_MEAS", "the ordered joints, $AXIS_ACT, replace it", "optional"),
    Need("$EX_AX_NUM", "no external axis", "optional"),
    Need("$AXIS_JUS[7]", "E1 counts as mastered", "optional"),
)  # fmt: skip


def refused_motion(error: int) -> DeviceError:
    text, code = ERRORS.get(error, ("unknown", "HC-B20"))
    found, act = f"HC_ERR {error}: {text}", "read the panel, then resume"
    return ROBOT.failed(code, "move", found, act=act, error=error)


def frame_text(values: tuple[float, ...] | list[float]) -> str:
    return ", ".join(f"{n} {v:.3f}" for n, v in zip(POSE, values, strict=True))


class KeepAlive:
    """Sends a request over every connection that has been idle for `IDLE_S`. The thread stores a
    failure; the next use of the device raises it.
    """

    IDLE_S = 8.0  # of a connection, which is then asked something
    PERIOD_S = 1.0
    JOIN_S = 3.0

    def __init__(self, *lines: ControllerLink) -> None:
        self._lines = lines
        self._failure: HilcellError | None = None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keep-alive", daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Raise the error that broke a connection."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        self._end.set()
        self._thread.join(self.JOIN_S)

    def _run(self) -> None:
        try:
            while not self._end.wait(self.PERIOD_S):
                for line in self._lines:
                    if time.monotonic() - line.used_s > self.IDLE_S:
                        line.keep_alive()
        except Stopped:
            return  # the run ends; nothing needs these connections any longer
        except HilcellError as error:
            self._failure = error
