"""The wire to a KUKA controller and its program hilcell, and the states that work needs of both.

While a motion is under way the program ``hilcell.src`` runs a timer of the controller up to zero;
there it brakes, latches like HC_STOP, and drops the command. The PC sets the timer back with each
sign. A sign comes only from the thread that watches the motion: an engine that hangs gives none.

The trap: KUKAVARPROXY drops a client after 30 s without a request, and a stop sent over a dropped
connection is lost. So a thread asks something harmless of idle connections.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Generic, Protocol, TypeVar

from drivers.device_errors import ROBOT
from drivers.kuka import krl
from drivers.kuka.krl import POSE
from drivers.supervision import LIFE_S
from hilcell.ports import Array, DeviceError, HilcellError, Stopped

PROGRESS = "$AXIS_ACT"
PROGRAM_VERSION = 4  # of hilcell.src


class Access(Protocol):
    """Variables of the controller by their names, and brake and override."""

    def look(self) -> None:
        """From here on, values are to be as new as this call."""

    def value(self, name: str) -> krl.Value:
        """Return a single value; raises `DeviceError`."""

    def numbers(self, name: str, components: tuple[str, ...]) -> list[float]:
        """Return components of a structure; raises `DeviceError`."""

    def brake(self) -> None:
        """Stop the robot; the program has heard it."""

    def release(self) -> None:
        """Take a stop back; nothing moves by it."""

    def lower_override(self, found: int, wanted: int) -> None:
        """Lower $OV_PRO so that the controller itself knows its old value."""

    def give_back_override(self) -> None:
        """Give back an override that was lowered; the robot must stand."""

    def lowered_override(self) -> bool:
        """Whether an override is still to be given back."""


class Controller(Access, Protocol):
    """The open wires to one controller."""

    address: str
    versions: dict[str, int]  # what must be installed: the number of each

    @property
    def rounds(self) -> Sequence[tuple[str, ...]]:
        """Return what to look at: each poll of a motion looks at the next of these."""

    @property
    def ready(self) -> tuple[str, ...]:
        """Return what to look at before a motion is ordered."""

    @property
    def measured(self) -> str:
        """Return the variable of the measured joints, or of the ordered ones without it."""

    def text(self, name: str) -> str:
        """Return a text, cleaned."""

    def start(self, number: int, target_deg: Array, speed_percent: int) -> None:
        """Hand a motion to joints (6,) over; a held slide's place (mm) may follow (7,)."""

    def sign(self) -> None:
        """Give the program a sign of life, if one is due."""

    def undisturbed(self) -> AbstractContextManager[Access]:
        """Return an access whose waits a stop does not end."""

    def stop(self) -> None:
        """Brake; any thread; waits for no answer."""

    def check(self) -> None:
        """Raise what an idle wire has failed by."""

    def close(self) -> None:
        """Close the wires."""

    def has_slide(self) -> bool:
        """Whether the controller has an external axis."""

    def mastered(self) -> bool:
        """Whether E1 is; True where the controller does not tell, for then it refuses itself."""

    def start_slide(self, number: int, place_mm: float, speed_percent: int) -> None:
        """Hand a motion of E1 alone over."""

    def hold_slide(self, held: bool) -> None:
        """Have the program refuse every motion of E1, or allow it."""

    def slide(self) -> tuple[float, bool]:
        """Return where E1 is in mm, and whether it is held."""


def integer(access: Access, name: str) -> int:
    """Return a whole number that the controller has; raises `DeviceError`."""
    value = access.value(name)
    if isinstance(value, bool) or not isinstance(value, int):
        raise unreadable(name, f"expected a whole number, got {value!r}")
    return value


def unreadable(name: str, found: object) -> DeviceError:
    """Return the error for a value that is not what belongs there."""
    return ROBOT.failed("HC-B26", f"read {name}", str(found), variable=name)


@contextmanager
def readable(name: str) -> Iterator[None]:
    """Raise `DeviceError` where a value is not what belongs there."""
    try:
        yield
    except ValueError as error:
        raise unreadable(name, error) from error


def override_held(found: int, wanted: int) -> None:
    """Raise `DeviceError` where an override did not become what was wanted."""
    if found != wanted:
        raise ROBOT.failed(
            "HC-B40",
            "sweep",
            f"$OV_PRO is {found}",
            wanted=f"{wanted}",
            override=found,
            wanted_override=wanted,
        )


LOST, STOPPED = 8, 9  # HC_ERR
# HC_ERR in words, and its alarm.
ERRORS = {
    1: ("unknown command", "HC-B20"),
    2: ("target outside the software limits", "HC-B20"),
    3: ("external axis E1 has left the place at which it is held", "HC-R52"),
    4: ("external axis E1 is held", "HC-B20"),
    5: ("external axis E1 is not held, so the arm stays", "HC-B20"),
    LOST: ("the PC's life sign was late, and the robot has braked by itself", "HC-B43"),
    STOPPED: ("stopped by HC_STOP", "HC-B21"),
}

# Variable, the values with which work may go on, the alarm otherwise; causes first.
HEALTH: dict[str, tuple[tuple[str | bool, ...], str]] = {
    "$ALARM_STOP": ((True,), "HC-B10"),
    "$USER_SAF": ((True,), "HC-B11"),
    "$MODE_OP": (("#EX", "#AUT"), "HC-B12"),
    "$PERI_RDY": ((True,), "HC-B13"),
    "$STOPMESS": ((False,), "HC-B14"),
    "$PRO_STATE1": (("#P_ACTIVE",), "HC-B15"),
}


def refused_motion(error: int) -> DeviceError:
    """Return the error for HC_ERR of a motion."""
    text, code = ERRORS.get(error, ("unknown", "HC-B20"))
    act = "see the panel, resume"
    return ROBOT.failed(code, "move", f"HC_ERR {error}: {text}", act=act, error=error)


def frame_text(values: tuple[float, ...] | list[float]) -> str:
    return ", ".join(f"{n} {v:.3f}" for n, v in zip(POSE, values, strict=True))


class LifeSign:
    """Signs of life to one controller's program, from its first motion on."""

    EVERY_S = 0.2
    TIMER = "$TIMER[10]"

    def __init__(self, write: Callable[[str, str], None]) -> None:
        """``write`` sets a variable of the controller."""
        self._write, self._due_s = write, math.inf

    def begin(self) -> None:
        """A motion is about to begin: tell the program how long the PC may keep silent."""
        if self._due_s == math.inf:
            self._write("HC_LIFE", str(round(LIFE_S * 1000)))
        self._due_s = time.monotonic() + self.EVERY_S

    def give(self) -> None:
        """Give a sign, if one is due."""
        if time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + self.EVERY_S
            self._write(self.TIMER, str(round(-LIFE_S * 1000)))


class Connection(Protocol):
    """One that knows when it was used last, by ``time.monotonic()``."""

    used_s: float


Kept = TypeVar("Kept", bound=Connection)


class KeepAlive(Generic[Kept]):
    """Calls ``ask`` with every connection that has been idle for `IDLE_S`.

    The thread keeps a failure that it finds; the device's next use raises it.
    """

    IDLE_S = 8.0  # of a connection, which is then asked something
    LOOK_S = 1.0
    JOIN_S = 3.0

    def __init__(self, connections: Sequence[Kept], ask: Callable[[Kept], object]) -> None:
        self._connections, self._ask = connections, ask
        self._failure: HilcellError | None = None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keep-alive", daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Raise the error that broke a connection since the last look."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        self._end.set()
        self._thread.join(self.JOIN_S)

    def _run(self) -> None:
        try:
            while not self._end.wait(self.LOOK_S):
                for connection in self._connections:
                    if time.monotonic() - connection.used_s > self.IDLE_S:
                        self._ask(connection)
        except Stopped:
            return  # the run ends; nothing needs these connections any longer
        except HilcellError as error:
            self._failure = error
