"""The robot controller: system variables and the resident program hilcell.src, as KRL text.

Values as KRL writes them: ``{E6AXIS: A1 0.00000, A2 -90.00000}``, ``#EX``, ``TRUE``, ``100``.
Joints and poses are the controller's nominal ones, never the truth. The program waits for ``HC_SEQ
<> HC_ACK``, moves, then sets HC_ERR and HC_ACK. HC_STOP brakes and keeps the program in its
interrupt until it is FALSE again; so does the watchdog timer of a motion at zero.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from functools import partial

import numpy as np

from fakes.faults import Faults, Vanished
from fakes.site import Site
from fakes.time import WatchdogTimer
from fakes.truth.cell_truth import apply_start_faults
from fakes.truth.machine import controller_arm
from fakes.truth.noise import Dither, readout_noise
from fakes.truth.rail_truth import RailState, RailTruth
from fakes.truth.robot_motion import RobotState
from fakes.truth.transforms import Array, components
from hilcell.cell.file import RailTable

_AGGREGATE = re.compile(r"^\{\s*(?:(\w+)\s*:)?\s*(.*?)\s*\}$", re.DOTALL)
_NUMBER = re.compile(r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")


class KrlError(ValueError):
    """A text that KRL refuses."""


def members(values: Mapping[str, float | int]) -> str:
    """Return the text of a structure's members; integers stay so, reals get five decimals."""
    return ", ".join(
        f"{name} {value}" if isinstance(value, int) else f"{name} {round(value, 5) + 0.0:.5f}"
        for name, value in values.items()
    )


def aggregate(kind: str, values: Mapping[str, float | int], *more: str) -> str:
    """Return a structure's text; ``more`` are texts of further members."""
    return f"{{{kind}: {', '.join([members(values), *more])}}}"


def raw_members(text: str, kind: str = "") -> dict[str, str]:
    """Return the members of a structure as text; raises `KrlError`, also for another ``kind``."""
    match = _AGGREGATE.match(text.strip())
    if match is None or (kind and (match[1] or kind).upper() != kind):
        raise KrlError(text)
    parts = (part.strip().partition(" ") for part in match[2].split(","))
    return {name: value.strip() for name, _, value in parts}


RAIL_DRIVER = "kuka-e1"
PROGRAM = 4  # version of hilcell.src
AXES = tuple(f"A{n}" for n in range(1, 7))
FRAME = ("X", "Y", "Z", "A", "B", "C")


class ExternalAxis:
    """External axis E1: the slide, with an absolute encoder and a brake.

    Its controller's lock guards it.
    """

    STOP_MM_S2 = 800.0  # on a stop
    DITHER_MM, DITHER_SCOPE = 0.001, 7

    def __init__(
        self, rail: RailTruth, faults: Faults, table: RailTable, limits_mm: tuple[float, float]
    ) -> None:
        self._rail, self._faults, self._table = rail, faults, table
        self.limits_mm = limits_mm
        self.held = True
        self.moving = False
        self._target_mm, self._speed_mm_s = 0.0, 0.0
        self._dither = Dither(1, self.DITHER_SCOPE)
        rail.master()

    def inside(self, target_mm: float) -> bool:
        return self.limits_mm[0] <= target_mm <= self.limits_mm[1]

    def move(self, target_mm: float, percent: int, override: float) -> None:
        factor = self._faults.number("robot.slide_fast") or 1.0
        self._rail.brake(closed=False)
        full_mm_s = 1890.0  # at 100 %
        self._target_mm, self._speed_mm_s = target_mm, full_mm_s * percent / 100.0 * factor
        self.moving = True
        self.override(override)

    def override(self, share: float) -> None:
        """Change the speed of a motion in progress; 0 stops it."""
        if not self.moving:
            return
        if share > 0:
            speed_mm_s, ramp_mm_s2 = self._speed_mm_s * share, self._table.acceleration_mm_s2
            self._rail.move(self._target_mm, speed_mm_s, ramp_mm_s2)
        else:
            self._rail.quick_stop(self.STOP_MM_S2)

    def stop(self) -> None:
        """Brake, discard the target, and hold the slide."""
        self.held = True
        if self.moving:
            self._rail.quick_stop(self.STOP_MM_S2)
            self.moving = False

    def poll(self, share: float) -> RailState:
        """Return the slide's state; ``share`` is the override, at 0 no motion ends."""
        state = self._rail.poll()
        if not state.moving:
            self.moving = self.moving and not share > 0
            self._rail.brake(closed=self.held)
        return state

    @property
    def axes_moving(self) -> bool:
        """Whether the slide moves; no time passes."""
        return not self._rail.at_rest

    def reading_mm(self, state: RailState, *, alone: bool) -> float:
        """Return the reading; at rest it dithers, by a step each time E1 is read ``alone``."""
        if alone:
            self._dither.step()
        return state.encoder_mm + (0.0 if state.moving else self.DITHER_MM * self._dither.counts)


class Error(IntEnum):
    """Values of HC_ERR."""

    OK = 0
    UNKNOWN_COMMAND = 1
    OUT_OF_LIMITS = 2
    SLIDE_AWAY = 3
    SLIDE_HELD = 4
    SLIDE_FREE = 5
    LOST = 8
    STOPPED = 9


class KrlController:
    """One robot's controller, with the slide if that is its axis E1; safe to use from several
    threads.
    """

    PTP, SLIDE = 1, 2  # values of HC_CMD
    FLICKER_POSE = np.array([1e-3] * 3 + [1e-4] * 3)  # mm and deg
    EXTERNAL = members({f"E{n}": 0.0 for n in range(1, 7)})

    def __init__(self, site: Site) -> None:
        self._lock = threading.RLock()
        cell, truth, faults = site.cell, site.truth, site.faults
        self._truth, self._motion, self._faults = truth, truth.robot, faults
        self._arm = arm = controller_arm(cell)
        self._slide: ExternalAxis | None = None
        if cell.rail.driver == RAIL_DRIVER and isinstance(truth.rail, RailTruth):
            self._slide = ExternalAxis(truth.rail, faults, cell.rail, arm.slide_limits_mm)
        self._slide_mm = 0.0  # where it is held
        self._limits_deg = [*arm.limits_deg.tolist(), arm.slide_limits_mm]
        self._tool = dict(zip(FRAME, (*arm.tool_mm, 0.0, 0.0, 0.0), strict=True))
        self._target_deg = dict(zip(AXES, cell.robot.home_deg, strict=True))
        self._integers = dict.fromkeys(("HC_CMD", "HC_SEQ", "HC_OV_OLD", "HC_OV_SET"), 0)
        self._integers |= {"HC_VEL": 1, "HC_LIFE": 1500}  # %, ms
        self._timer = WatchdogTimer(self._watchdog_expired)
        self._override, self._share = 100, 1.0
        self._stale: dict[str, str] = {}
        self._pose, self._status_and_turn = np.zeros(6), {"S": 0, "T": 0}
        self._pose_joints: Array | None = None
        self._polls = 0
        self._snapshot: RobotState | None = None  # that several variables are read of
        self._readers = self._all_readers()
        self.restore()

    def restore(self) -> None:
        with self._lock:
            self._mode, self._program = "#EX", "#P_ACTIVE"
            self._emergency, self._message = False, False
            self._in_stop = False
            self._running: int | None = None
            self._hold_slide()
            self._timer.stop()
            self._acknowledge_lost = self._frozen = False
            self._acknowledged, self._error = self._integers["HC_SEQ"], int(Error.OK)
            self._set_override(100)

    def read(self, name: str) -> str:
        """Return a variable's text; raises `KrlError` for an unknown one."""
        with self._lock:
            reader = self._readers.get(name.strip().upper())
            if reader is None:
                raise KrlError(name)
            self._apply_request_faults()
            self._run_program()
            return reader()

    def read_all(self, names: Sequence[str]) -> list[str]:
        with self._lock:
            self._apply_request_faults()
            self._snapshot = self._poll()
            try:
                return [self._readers[name]() for name in names]
            finally:
                self._snapshot = None

    def write(self, name: str, text: str) -> None:
        """Set a variable from its text; raises `ValueError` as KRL refuses it."""
        name = name.strip().upper()
        with self._lock:
            self._apply_request_faults()
            if name == "HC_TGT":
                found = raw_members(text, "E6AXIS")  # whose name may be left out
                if not all(map(_NUMBER.match, found.values())):
                    raise KrlError(text)
                self._target_deg |= {axis.upper(): float(deg) for axis, deg in found.items()}
            elif name in self._integers:
                self._integers[name] = int(text)
            elif name == "$TIMER[10]":
                self._timer.set_ms(int(text))
            elif name == "HC_HELD" and self._slide is not None:
                self._slide.held = self._parse_boolean(text)
            elif name == "HC_STOP":
                self._stop(self._parse_boolean(text))
            elif name == "$OV_PRO":
                if not _NUMBER.match(text.strip()) or not math.isfinite(float(text)):
                    raise KrlError(text)
                self._set_override(math.floor(float(text) + 0.5))  # a REAL becomes an INT
            else:
                raise KrlError(name)
            self._run_program()

    # -- variables to read ----------------------------------------------------------------------

    def _all_readers(self) -> dict[str, Callable[[], str]]:
        return {
            "$MODE_OP": lambda: self._mode,
            "$PERI_RDY": lambda: self._boolean(not self._emergency),
            "$STOPMESS": lambda: self._boolean(self._message),
            "$ALARM_STOP": lambda: self._boolean(not self._emergency),
            "$USER_SAF": lambda: self._boolean(True),
            "$PRO_STATE": lambda: self._program,
            "$PRO_STATE1": lambda: self._program,
            "$OV_PRO": lambda: str(self._override),
            "$ACT_TOOL": lambda: str(self._faults.instead("robot.wrong_tool", 1)),
            "$ACT_BASE": lambda: str(self._faults.instead("robot.wrong_base", 0)),
            "$TOOL": lambda: aggregate("FRAME", self._tool),
            "TOOL_DATA[1]": lambda: aggregate("FRAME", self._tool),
            **{
                f"${end}_END[{axis}]": partial(self._limit, axis - 1, side)
                for side, end in enumerate(("SOFTN", "SOFTP"))
                for axis in range(1, 8)
            },
            "$BASE": lambda: aggregate("FRAME", dict.fromkeys(FRAME, 0.0)),
            "$ACCU_STATE": lambda: "#CHARGE_OK",
            "$TRAFONAME[]": self._identity,
            "$KR_SERIALNO": lambda: str(self._arm.serial),
            "$ROBNAME[]": lambda: '"HILCELL"',
            "$EX_AX_NUM": self._read_slide_count,
            "$AXIS_JUS[7]": lambda: self._boolean(
                not self._faults.strikes("robot.slide_unmastered")
            ),
            "$AXIS_ACT.E1": self._read_e1,
            "$AXIS_ACT": lambda: self._position("$AXIS_ACT"),
            "$AXIS_ACT_MEAS": lambda: self._position("$AXIS_ACT_MEAS"),
            "$POS_ACT": lambda: self._position("$POS_ACT"),
            "HC_VER": lambda: str(self._arm.program or PROGRAM),
            "$TIMER[10]": lambda: str(self._timer.value_ms),
            "HC_HELD": lambda: self._boolean(self._slide is None or self._slide.held),
            "HC_PLACE": lambda: f"{self._slide_mm:.5f}",
            "HC_TGT": lambda: aggregate("E6AXIS", self._target_deg, self.EXTERNAL),
            "HC_ACK": self._read_acknowledge,
            "HC_ERR": lambda: str(self._error),
            "HC_STOP": lambda: self._boolean(self._in_stop),
            **{name: partial(self._integer, name) for name in self._integers},
        }

    def _integer(self, name: str) -> str:
        return str(self._integers[name])

    def _limit(self, axis: int, side: int) -> str:
        return f"{self._limits_deg[axis][side]:.5f}"

    def _identity(self) -> str:
        other = self._faults.take("robot.wrong_identity")
        if other is None:
            return f'"{self._arm.model} SIMULATED"'
        return '"#KR6R900"' if other is True else f'"{other}"'

    def _read_acknowledge(self) -> str:
        if self._snapshot is None:
            self._polls = 0
        self._poll()
        return str(self._acknowledged)

    def _position(self, which: str) -> str:
        state = self._poll()
        if self._faults.strikes("robot.stale_position") and which in self._stale:
            return self._stale[which]
        text = self._stale[which] = self._position_text(which, state)
        bad = self._faults.take("robot.bad_number")
        if bad is not None:
            kind, members = text.split(": ", 1)
            first, rest = members.split(",", 1)
            return f"{kind}: {first.split()[0]} {bad},{rest}"
        return text

    def _position_text(self, which: str, state: RobotState) -> str:
        off, joints_rad = np.zeros(6), state.joints_rad
        cycle_s = 0.012  # interpolation cycle: measured axes are those of its last tick
        if state.moving and which == "$AXIS_ACT_MEAS":
            joints_rad, tick = self._motion.measured(cycle_s)
            off = readout_noise(state.landing_rad.tobytes(), tick, 6)
        elif not state.moving:
            self._polls += 1
            landed = state.joints_rad.tobytes() + state.landing_rad.tobytes()
            off = readout_noise(landed, self._polls, 6)
        flicker_deg = 1e-4  # of each axis at rest
        if which != "$POS_ACT":
            axes_deg = np.degrees(joints_rad) + flicker_deg * off
            axes = dict(zip(AXES, axes_deg.tolist(), strict=True))
            return aggregate("E6AXIS", axes, self._external())
        if state.joints_rad is not self._pose_joints:  # the same array at rest
            self._pose_joints, arm = state.joints_rad, self._arm
            self._pose = components(arm.chain.pose(state.joints_rad))
            self._status_and_turn = {
                "S": arm.status(state.joints_rad),
                "T": arm.turn(state.joints_rad),
            }
        pose = (self._pose + self.FLICKER_POSE * off).tolist()
        return aggregate(
            "E6POS", dict(zip(FRAME, pose, strict=True)) | self._status_and_turn, self._external()
        )

    # -- external axis E1 -----------------------------------------------------------------------

    def _read_slide_count(self) -> str:
        return str(int(self._slide is not None and not self._faults.strikes("robot.no_slide")))

    def _read_e1(self) -> str:
        if self._slide is None:
            raise KrlError("$AXIS_ACT.E1")
        self._poll()
        state = self._slide.poll(self._share)
        return f"{self._slide.reading_mm(state, alone=True):.5f}"

    def _external(self) -> str:
        if self._slide is None:
            return self.EXTERNAL
        reading_mm = self._slide.reading_mm(self._slide.poll(self._share), alone=False)
        return members({"E1": reading_mm} | {f"E{n}": 0.0 for n in range(2, 7)})

    def _hold_slide(self) -> None:
        """Hold the slide where it is, or where it comes to rest."""
        if self._slide is not None:
            self._slide.stop()
            self._slide_mm = self._slide.poll(self._share).encoder_mm

    def _start_slide(self) -> int:
        if self._slide is None:
            return Error.UNKNOWN_COMMAND
        if self._slide.held:
            return Error.SLIDE_HELD
        target_mm = self._target_deg["E1"]
        softlimit = self._faults.strikes("robot.softlimit")
        if softlimit or not self._slide.inside(target_mm):
            return Error.OUT_OF_LIMITS
        self._acknowledge_lost = self._faults.strikes("robot.ack_previous")
        self._frozen = self._faults.strikes("robot.frozen")
        if not self._frozen:
            self._slide.move(target_mm, min(max(self._integers["HC_VEL"], 1), 100), self._share)
        self._slide_mm = target_mm
        self._timer.start(-self._integers["HC_LIFE"])
        return Error.OK

    def _slide_error(self) -> int:
        """Return the error of the slide that forbids a motion of the arm, or `OK`."""
        if self._slide is None:
            return Error.OK
        if not self._slide.held:
            return Error.SLIDE_FREE
        away_mm = abs(self._slide.poll(self._share).encoder_mm - self._slide_mm)
        slide_mm = 0.05  # largest deviation of a held slide
        return Error.OK if away_mm <= slide_mm else Error.SLIDE_AWAY

    @property
    def _slide_in_motion(self) -> bool:
        return self._slide is not None and self._slide.axes_moving

    # -- the resident program -------------------------------------------------------------------

    def _run_program(self) -> None:
        ready = self._program == "#P_ACTIVE" and not self._in_stop
        if self._running is not None:
            moves = self._motion.moving or (self._slide is not None and self._slide.moving)
            if ready and not moves and not self._frozen:
                self._acknowledge()
        elif ready and self._integers["HC_SEQ"] != self._acknowledged:
            self._running = self._integers["HC_SEQ"]
            self._error = self._start()
            if self._error != Error.OK:
                self._acknowledge()

    def _start(self) -> int:
        self._polls = 0
        if self._integers["HC_CMD"] == self.SLIDE:
            return self._start_slide()
        if self._integers["HC_CMD"] != self.PTP:
            return Error.UNKNOWN_COMMAND
        if (forbidden := self._slide_error()) != Error.OK:
            return forbidden
        target_deg = np.array([self._target_deg[axis] for axis in AXES])
        low_deg, high_deg = self._arm.limits_deg.T
        inside = (target_deg >= low_deg) & (target_deg <= high_deg)
        if not inside.all() or self._faults.strikes("robot.softlimit"):
            return Error.OUT_OF_LIMITS
        motion = apply_start_faults(self._faults, self._truth, target_deg)
        self._acknowledge_lost, self._frozen = motion.acknowledge_lost, motion.frozen
        if not self._frozen:
            speed = min(max(self._integers["HC_VEL"], 1), 100) / 100.0
            self._motion.move(np.radians(motion.target_deg), speed)
        self._timer.start(-self._integers["HC_LIFE"])
        return Error.OK

    def _acknowledge(self) -> None:
        if self._running is not None and not self._acknowledge_lost:
            self._acknowledged, self._running = self._running, None
            self._timer.stop()

    def _stop(self, wanted: bool) -> None:
        if wanted and not self._in_stop:
            self._brake(Error.STOPPED)
        elif not wanted and self._in_stop and not self._slide_in_motion:
            self._in_stop = self._acknowledge_lost = self._frozen = False
            self._hold_slide()
            self._running = None
            self._acknowledged = self._integers["HC_SEQ"]

    def _brake(self, why: int) -> None:
        self._timer.stop()
        self._in_stop, self._error = True, why
        self._halt(self._program)

    def _halt(self, state: str) -> None:
        """Brake all axes; ``state`` is the program's."""
        self._program = state
        self._motion.brake()
        if self._slide is not None:
            self._slide.stop()

    def _watchdog_expired(self) -> None:
        """Brake a motion without a sign of life in time; called by the timer's thread."""
        with self._lock:
            self._run_program()  # the motion may have ended meanwhile
            if self._timer.expired and self._running is not None and not self._in_stop:
                self._brake(Error.LOST)

    def _set_override(self, percent: int) -> None:
        if not 0 <= percent <= 100:
            raise KrlError(f"$OV_PRO {percent}")
        self._override, self._share = percent, percent / 100.0
        self._motion.override(self._share)
        if self._slide is not None:
            self._slide.override(self._share)

    # -- faults ---------------------------------------------------------------------------------

    def _apply_request_faults(self) -> None:
        if self._faults.strikes("robot.mode_t1"):
            self._mode = "#T1"
            self._halt("#P_STOP")
        if self._faults.strikes("robot.deselected"):
            self._halt("#P_FREE")

    def _poll(self) -> RobotState:
        if self._snapshot is not None:
            return self._snapshot
        self._apply_motion_faults()
        state = self._motion.poll()
        if self._slide is not None:
            self._slide.poll(self._share)
        self._run_program()
        return state

    def _apply_motion_faults(self) -> None:
        """Apply the faults of a moving robot, and those that are set to strike at rest."""
        moving = self._motion.axes_moving or self._slide_in_motion
        strikes = partial(self._faults.strikes, moving=moving)
        if strikes("robot.vanish"):
            raise Vanished
        if strikes("robot.e_stop"):
            self._emergency = self._message = True
            self._halt("#P_STOP")
        if strikes("robot.stopmess"):
            self._message = True
            self._halt("#P_STOP")
        if strikes("robot.override_zero"):
            self._set_override(0)

    @staticmethod
    def _boolean(value: bool) -> str:
        return str(value).upper()

    @staticmethod
    def _parse_boolean(text: str) -> bool:
        """Return the value of TRUE or FALSE; raises `KrlError`."""
        if (word := text.strip().upper()) not in ("TRUE", "FALSE"):
            raise KrlError(text)
        return word == "TRUE"
