"""One ABB controller: its panel, its RAPID task with the module hilcell, its motion and its log."""

from __future__ import annotations

import re
import threading
from functools import partial

import numpy as np

from fakes.faults import Vanished
from fakes.site import Site
from fakes.time import WatchdogTimer
from fakes.truth.cell_truth import apply_start_faults
from fakes.truth.machine import controller_arm
from fakes.truth.noise import readout_noise
from fakes.truth.transforms import Array

VERSION, DEVICE = 3, "UCdevice"
STATE, ERROR = 1, 3  # types of events
LOST, BRAKED = 8, 9
NUMBERS = ("hc_session", "hc_life", "hc_order", "hc_brake", "hc_seconds")


class RapidError(Exception):
    """A RAPID value that does not fit its data."""


class AbbController:
    """One robot's controller; safe to use from several threads.

    Joints and poses are the controller's nominal ones, never the truth. Only the routine
    ``hc_main`` of the module hilcell moves the arm, and only while it runs: it waits for a new
    number, moves, and acknowledges. A motion without the PC's sign of life is stopped.
    """

    CYCLE_S = 0.004
    LIFE_MS = 1500

    def __init__(self, site: Site) -> None:
        self._lock = threading.RLock()
        self._truth, self._motion = site.truth, site.truth.robot
        self._faults, self._time, cell = site.faults, site.time, site.cell
        self._arm = controller_arm(cell)
        self._full_rad_s = np.radians([joint.speed_deg_s for joint in cell.robot.joint])
        self.tool_mm, self.limits_deg = self._arm.tool_mm, self._arm.limits_deg
        self.version, self.streams_to = self._arm.program or VERSION, DEVICE
        self.options = ["RobotWare Base", "616-1 PC Interface", "689-1 Externally Guided Motion"]
        self.loaded, self.absolute = True, False
        self.kind = "Real Controller"
        self.load_kg = "20"  # of hc_tool, as a person has entered it
        self.numbers = dict.fromkeys(NUMBERS, 0.0)
        self._target_deg = np.degrees(self._motion.state().joints_rad)
        self._state = [0, 0, 0, 0, 0, 0]  # version, session, life, done, error, begun
        self._timer = WatchdogTimer(self._watchdog_expired)
        self._pointer = ""  # routine
        self._running = self._in_motion = self._frozen = self._acknowledge_lost = False
        self.log: list[tuple[int, int, str]] = []  # type, code, title; the newest last
        self._stale: Array | None = None
        self._stamp_s = 0.0  # time of the newest position
        self.restore()

    def restore(self) -> None:
        """Clear all faults, as an operator does; no program runs."""
        with self._lock:
            self.mode, self.panel, self.ratio = "AUTO", "motoron", 100.0
            self.pendant_has_mastership = self._wrong_tool = False
            self._end_program()
            self._motion.override(1.0)

    @property
    def model(self) -> str:
        other = self._faults.take("robot.wrong_identity")
        if other is None:
            return f"{self._arm.model} SIMULATED"
        return "IRB 120-3/0.6" if other is True else str(other)

    @property
    def serial(self) -> str:
        return str(self._arm.serial)

    @property
    def running(self) -> bool:
        return self._running

    def set_ratio(self, percent: float) -> None:
        with self._lock:
            self.ratio = percent
            self._motion.override(percent / 100.0)

    # -- what web services ask for ------------------------------------------------------------

    def asked(self) -> None:
        """Apply what happens with a request."""
        with self._lock:
            strikes = self._faults.strikes
            if strikes("robot.mode_t1"):
                self.mode = "MANR"
                self._stop_program(10015, "Manual mode selected", STATE)
            if strikes("robot.deselected"):  # a person at the pendant moves the program pointer
                self.pendant_has_mastership = True
                self._stop_program(10125, "Program stopped", STATE)
            if strikes("robot.mastership_taken"):
                self.pendant_has_mastership = True
            if strikes("robot.restarted"):
                self._end_program()
                self.panel, self._state = "init", [0] * 6
            if strikes("robot.wrong_tool"):
                self._wrong_tool = True

    def read_symbol(self, name: str) -> str | None:
        """Return RAPID data of the module as RAPID writes it, None if there is no such data."""
        with self._lock:
            if not self.loaded:
                return None
            if name == "hc_state":
                self._look()
                return f"[{','.join(map(str, self._state))}]"
            if name in self.numbers:
                return f"{self.numbers[name]:g}"
            if name == "hc_version":
                return str(self.version)
            if name == "hc_device":
                return f'"{self.streams_to}"'
            if name == "hc_target":
                joints = ",".join(f"{each:.6g}" for each in self._target_deg)
                return f"[[{joints}],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]"
            if name == "hc_tool":
                x, y, z = (0.0, 0.0, 0.0) if self._wrong_tool else self.tool_mm
                load = f"[{self.load_kg},[0,0,100],[1,0,0,0],0,0,0]"
                return f"[TRUE,[[{x:g},{y:g},{z:g}],[1,0,0,0]],{load}]"
            return None

    def write_symbol(self, name: str, text: str) -> bool:
        """Set RAPID data; return whether there is such data. Raises `RapidError`."""
        with self._lock:
            if not self.loaded or name not in (*self.numbers, "hc_target"):
                return False
            if name == "hc_target":
                match = re.fullmatch(r"\[\[([^\[\]]+)\],\[([^\[\]]+)\]\]", text)
                if match is None:
                    raise RapidError(text)
                self._target_deg = np.array([_num(each) for each in match[1].split(",")])
                return True
            self.numbers[name] = _num(text)
            if self._running:
                self._interrupt(name)
            return True

    def set_pointer(self, routine: str) -> bool:
        with self._lock:
            if self._running or not self.loaded or routine != "hc_main":
                return False
            self._pointer = routine
            return True

    def start(self) -> bool:
        """Start the routine at the program pointer; return whether it runs."""
        with self._lock:
            ready = self.mode == "AUTO" and self.panel == "motoron"
            if self._running or not ready or not self._pointer:
                return False
            self._running = True
            self.numbers |= {"hc_order": 0.0, "hc_brake": 0.0}
            life, session = int(self.numbers["hc_life"]), int(self.numbers["hc_session"])
            self._state = [self.version, session, life, 0, 0, 0]
            return True

    def stop(self) -> None:
        with self._lock:
            self._end_program()

    def pose_and_joints(self) -> tuple[Array, Array]:
        """Return the reflector's frame (4, 4) in {B} and joints (6,) in deg."""
        with self._lock:
            joints_rad = self._motion.state().joints_rad
            if not self._running and not self._time.followed:
                self._motion.poll()  # the PC polls for the end of its session
            joints_rad = self._motion.state().joints_rad
            return self._arm.chain.pose(joints_rad), np.degrees(joints_rad)

    # -- the stream ---------------------------------------------------------------------------

    def measured(self) -> tuple[float, Array]:
        """Return the controller's time and joints (6,) in deg, as resolvers measure them."""
        with self._lock:
            now_s = self._time.now_s()
            if not self._faults.strikes("robot.stream_time"):
                self._stamp_s = now_s
            state = self._motion.state(now_s)
            joints_rad = state.joints_rad
            if not state.moving:
                landed = state.joints_rad.tobytes() + state.landing_rad.tobytes()
                off = readout_noise(landed, round(now_s / self.CYCLE_S), 6)
                dither_rad = 5e-6  # of a joint that holds
                joints_rad = joints_rad + dither_rad * off
            stale = self._faults.strikes("robot.stale_position")
            if stale and self._stale is not None:
                joints_rad = self._stale
            self._stale = joints_rad
            joints_deg = np.degrees(joints_rad)
            bad = self._faults.take("robot.bad_number")
            if bad is not None:
                joints_deg = np.array([float(bad), *joints_deg[1:]])
            return self._stamp_s, joints_deg

    @property
    def motors_on(self) -> bool:
        return self.panel == "motoron"

    # -- the module ---------------------------------------------------------------------------

    def _look(self) -> None:
        """Let what happens to a motion happen, and advance it."""
        moving = self._motion.axes_moving
        strikes = partial(self._faults.strikes, moving=moving)
        if strikes("robot.vanish"):
            raise Vanished
        if strikes("robot.e_stop"):
            self.panel = "emergencystop"
            self._stop_program(10013, "Emergency stop state", STATE)
        if strikes("robot.motors_off"):
            self.panel = "motoroff"
            self._stop_program(10010, "Motors OFF state", STATE)
        if (ratio := self._faults.take("robot.speed_ratio", moving=moving)) is not None:
            self.set_ratio(float(ratio))
        if strikes("robot.stopmess"):
            self._stop_program(50204, "Motion supervision")
        if strikes("robot.override_zero"):
            self.set_ratio(0.0)
        if not self._time.followed:
            self._motion.poll()
        self._run()

    def _interrupt(self, name: str) -> None:
        """Let the module see a value that was written."""
        if name == "hc_life":
            self._state[2] = int(self.numbers["hc_life"])
            self._timer.set_ms(-self.LIFE_MS)
        elif name == "hc_session" and not self._in_motion:
            self._end_program()
        elif name == "hc_brake" and self._in_motion and self.numbers[name] == self._state[5]:
            self._brake(BRAKED)
        self._run()
        # An exchange takes time, which only passes here; a sign of life takes none, for a slow PC
        # sends more of them.
        if self._time.followed and name != "hc_life":
            self._motion.poll()

    def _run(self) -> None:
        if not self._running:
            return
        if self._in_motion:
            if not self._motion.moving and not self._frozen:
                self._acknowledge(0)
        elif int(self.numbers["hc_order"]) != self._state[3]:
            self._begin(int(self.numbers["hc_order"]))

    def _begin(self, number: int) -> None:
        self._state[5], self._state[4] = number, 0
        if self.numbers["hc_brake"] == number:
            self._state[4], self._state[3] = BRAKED, number
            return
        low_deg, high_deg = self._arm.limits_deg.T
        inside = (self._target_deg >= low_deg) & (self._target_deg <= high_deg)
        if not inside.all() or self._faults.strikes("robot.softlimit"):
            self._stop_program(50027, "Joint Out of Range")
            return
        motion = apply_start_faults(self._faults, self._truth, self._target_deg)
        self._acknowledge_lost, self._frozen = motion.acknowledge_lost, motion.frozen
        self._in_motion = True
        if not self._frozen:
            to_rad = np.radians(motion.target_deg)
            way_rad = np.abs(to_rad - self._motion.state().joints_rad)
            shortest_s = float(np.max(way_rad / self._full_rad_s))
            share = shortest_s / max(self.numbers["hc_seconds"], 1e-3)
            self._motion.move(to_rad, min(1.0, share) if share > 0 else 1.0)
        self._timer.start(-self.LIFE_MS)

    def _acknowledge(self, error: int) -> None:
        if not self._acknowledge_lost:
            self._timer.stop()
            self._in_motion = False
            self._state[4], self._state[3] = error, self._state[5]

    def _brake(self, why: int) -> None:
        self._motion.brake()
        self._acknowledge_lost = self._frozen = False
        self._acknowledge(why)

    def _stop_program(self, code: int, title: str, kind: int = ERROR) -> None:
        self.log.append((kind, code, title))
        self._end_program()

    def _end_program(self) -> None:
        self._timer.stop()
        if self._motion.moving:
            self._motion.brake()
        self._running, self._pointer = False, ""
        self._in_motion = self._acknowledge_lost = self._frozen = False

    def _watchdog_expired(self) -> None:
        """Stop a motion without a sign of life in time; called by the timer's thread."""
        with self._lock:
            self._run()  # the motion may have ended meanwhile
            if self._timer.expired and self._in_motion:
                self._brake(LOST)


def _num(text: str) -> float:
    """Return a number as RAPID's num holds it: with 24 bits."""
    try:
        return float(np.float32(float(text)))
    except ValueError as error:
        raise RapidError(text) from error
