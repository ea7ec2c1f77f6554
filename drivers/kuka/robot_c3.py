"""A KUKA robot through C3 Bridge or KUKAVARPROXY: variables of the controller, one at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property, partial

from drivers.kuka import krl
from drivers.kuka.c3 import C3Connection
from drivers.kuka.controller import (
    PROGRAM_VERSION,
    PROGRESS,
    integer,
    override_held,
    unreadable,
)
from drivers.kuka.external import SlidingKukaRobot
from drivers.kuka.health import AXES, SLIDE, LifeSign
from drivers.kuka.robot import KukaOptions
from drivers.robot_errors import DEVICE
from drivers.supervision import go_on, on_failure
from drivers.wires.keep_alive import KeepAlive
from hilcell.clean import clean
from hilcell.ports import Array, Clock
from hilcell.wire.channel import Port

PTP_JOINTS, PTP_SLIDE = 1, 2
MEASURED = "$AXIS_ACT_MEAS"
SLIDES, MASTERED, PLACE, HELD = "$EX_AX_NUM", "$AXIS_JUS[7]", "$AXIS_ACT.E1", "HC_HELD"


class C3Access:
    """Satisfies `drivers.kuka.controller.Access` over one connection."""

    def __init__(self, line: C3Connection) -> None:
        self._line = line

    def look(self) -> None:
        """Do nothing: each variable is asked for."""

    def value(self, name: str) -> krl.Value:
        """Read a single value."""
        text = self._line.read(name)
        try:
            return krl.parse(text)
        except krl.KrlError as error:
            raise unreadable(name, error) from error

    def numbers(self, name: str, components: tuple[str, ...]) -> list[float]:
        """Read components of a structure."""
        text = self._line.read(name)
        try:
            return krl.numbers(text, components)
        except krl.KrlError as error:
            raise unreadable(name, error) from error

    def brake(self) -> None:
        """Write the stop."""
        self._line.write("HC_STOP", "TRUE")

    def release(self) -> None:
        """Write that the stop is over, where there is one."""
        if self.value("HC_STOP") is not False:
            self._line.write("HC_STOP", "FALSE")

    def lower_override(self, found: int, wanted: int) -> None:
        """Write both values before the override itself."""
        self._line.write("HC_OV_SET", str(wanted))
        self._line.write("HC_OV_OLD", str(found))  # from here on the controller knows its old value
        self._line.write("$OV_PRO", str(wanted))
        override_held(integer(self, "$OV_PRO"), wanted)

    def give_back_override(self) -> None:
        """Write the old value, where nobody has changed the lowered one."""
        before = integer(self, "HC_OV_OLD")
        if before == 0:
            return
        if integer(self, "$OV_PRO") == integer(self, "HC_OV_SET"):
            self._line.write("$OV_PRO", str(before))
        self._line.write("HC_OV_OLD", "0")

    def lowered_override(self) -> bool:
        """Whether the old value is kept."""
        return integer(self, "HC_OV_OLD") != 0


class C3Controller(C3Access):
    """Satisfies `drivers.kuka.controller.Controller`.

    Each poll of a motion looks at HC_ACK and at the next of ``rounds``, so that all are seen within
    eight polls: with 4 to 12 ms an exchange, each of them once in 0.30 to 0.45 s.
    """

    rounds = (
        ("$ALARM_STOP",),
        ("$PRO_STATE1",),
        ("$MODE_OP",),
        ("$STOPMESS",),
        ("$USER_SAF",),
        ("$OV_PRO",),
        ("$PERI_RDY",),
        (PROGRESS,),
    )

    ready = ("$MODE_OP", "$USER_SAF")  # who may be near; an exchange each, and the rest follows

    def __init__(self, options: KukaC3Robot.Options, robot: SlidingKukaRobot) -> None:
        self._open = partial(C3Connection, DEVICE, options.host, options.port)
        self.address = f"{options.host}:{options.port}"
        self.versions = {"HC_VER": PROGRAM_VERSION}
        super().__init__(self._open(robot.attend))
        with on_failure(self._line.close):
            # The stop must get through while the run is already stopping.
            self._stop_line = self._open(go_on)
        self._keeper = KeepAlive((self._line, self._stop_line), lambda line: line.read("$MODE_OP"))
        self._life = LifeSign(self._line.write)

    @cached_property
    def measured(self) -> str:
        """Return the variable of measured joints, where the controller has it."""
        return MEASURED if self._line.knows(MEASURED) else PROGRESS

    def text(self, name: str) -> str:
        """Return a CHAR array; some servers leave the quotes out, or pad it."""
        return clean(self._line.read(name).strip("\0 \t\r\n").strip('"').strip())

    def start(self, number: int, target_deg: Array, speed_percent: int) -> None:
        """Write the target, and the number last."""
        axes = dict(zip((*AXES, SLIDE), target_deg.tolist(), strict=False))
        self._start(number, axes, PTP_JOINTS, speed_percent)

    def start_slide(self, number: int, place_mm: float, speed_percent: int) -> None:
        """Write the target of E1, and the number last; the program looks at no other axis of it."""
        joints_deg = self.numbers(PROGRESS, AXES)
        axes = dict(zip((*AXES, SLIDE), [*joints_deg, place_mm], strict=True))
        self._start(number, axes, PTP_SLIDE, speed_percent)

    def has_slide(self) -> bool:
        """Whether the controller counts an external axis."""
        return self._line.knows(SLIDES) and integer(self, SLIDES) > 0

    def mastered(self) -> bool:
        """Whether E1 is mastered."""
        return not self._line.knows(MASTERED) or self.value(MASTERED) is True

    def hold_slide(self, held: bool) -> None:
        """Write whether E1 may move."""
        self._line.write(HELD, "TRUE" if held else "FALSE")

    def slide(self) -> tuple[float, bool]:
        """Read the place of E1, which is less to send than all axes, and whether it is held."""
        place_mm = self.value(PLACE)
        if isinstance(place_mm, bool | str) or not abs(place_mm) <= krl.LARGEST:
            raise unreadable(PLACE, f"{place_mm!r} is no place")
        return float(place_mm), self.value(HELD) is True

    def _start(self, number: int, axes: dict[str, float], command: int, speed_percent: int) -> None:
        self._line.write("HC_TGT", krl.structure("E6AXIS", axes))
        self._line.write("HC_VEL", str(speed_percent))
        self._line.write("HC_CMD", str(command))
        self._life.begin()
        self._line.write("HC_SEQ", str(number))

    def sign(self) -> None:
        """Set the timer back."""
        self._life.give()

    @contextmanager
    def undisturbed(self) -> Iterator[C3Access]:
        """Open a connection for a while."""
        line = self._open(go_on)
        try:
            yield C3Access(line)
        finally:
            line.close()

    def stop(self) -> None:
        """Write the stop over its own connection."""
        self._stop_line.write_unheard("HC_STOP", "TRUE")

    def check(self) -> None:
        """Raise what the keep-alive has found."""
        self._keeper.check()

    def close(self) -> None:
        """Close both connections."""
        self._keeper.close()
        for line in (self._line, self._stop_line):
            line.close()


class KukaC3Robot(SlidingKukaRobot):
    """Satisfies `hilcell.ports.Robot`, `hilcell.ports.Sweeps` and `hilcell.ports.ExternalAxis`."""

    class Options(KukaOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Address and wanted identity of the controller."""

        port: Port = 7000

    def __init__(self, options: Options, clock: Clock) -> None:
        super().__init__(options, clock, partial(C3Controller, options))
