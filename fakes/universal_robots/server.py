"""A robot of Universal Robots on its three ports: RTDE, scripts, dashboard.

By the maker's RTDE Guide and Dashboard Server manual (e-Series). RTDE's packages are big-endian,
``size u16 | type u8 | payload``: states at a rate, registers in. In stepped time each state is a
cycle. One client at a time may write registers. Packages are sent as `fakes.wires` describes;
occasionally two are sent in one segment.
"""

from __future__ import annotations

import contextlib
import re
import select
import socket
import struct
import threading
import time
from enum import IntEnum
from functools import partial

import numpy as np

from fakes.faults import Vanished
from fakes.site import Site
from fakes.time import WatchdogTimer
from fakes.truth.cell_truth import apply_start_faults
from fakes.truth.machine import controller_arm
from fakes.truth.noise import readout_noise
from fakes.truth.transforms import Array, rotation_vector
from fakes.wires import HOST, RECEIVE, Listener, Segments, Server


class Mode(IntEnum):
    """Robot modes."""

    BOOTING = 2
    POWER_OFF = 3
    RUNNING = 7


class Safety(IntEnum):
    """States of the safety system."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class Runtime(IntEnum):
    """States of the program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSED = 4


class Error(IntEnum):
    """Results of a command of the program."""

    OK = 0
    UNKNOWN_COMMAND = 1
    OUT_OF_LIMITS = 2
    LOST = 8
    BRAKED = 9


Values = dict[str, float | int | Array]


class UrController:
    """One robot's controller; safe to use from several threads.

    Joints and poses are the controller's nominal ones, never the truth. It plays the last program
    of the script port. Only a program named ``hilcell`` moves the arm: it waits for a new sequence
    number in its register, moves, and acknowledges; a motion without the PC's heartbeat is braked.
    """

    STEP_S = 0.002  # of the controller
    LIFE_MS = 1500
    INTEGERS, FLOATS = range(24, 29), range(24, 31)  # that a client may write
    NAME = re.compile(r"^\s*def\s+(\w+)\s*\(", re.ASCII)
    SESSION = re.compile(r"write_output_integer_register\(26, (\d+)\)", re.ASCII)

    def __init__(self, site: Site) -> None:
        self._lock = threading.RLock()
        self._truth, self._motion = site.truth, site.truth.robot
        self._faults, self._time, cell = site.faults, site.time, site.cell
        self._arm = arm = controller_arm(cell)
        self._full_rad_s = np.radians([joint.speed_deg_s for joint in cell.robot.joint])
        self._tcp = np.array([*arm.tool_mm, 0.0, 0.0, 0.0]) / 1000.0
        # the registers that a client may write
        self.inputs: dict[str, float] = {f"input_int_register_{n}": 0 for n in self.INTEGERS}
        self.inputs |= {f"input_double_register_{n}": 0.0 for n in self.FLOATS}
        self._session = self._count = self._acknowledged = self._error = 0
        self._timer = WatchdogTimer(self._watchdog_expired)
        self._stale: Values | None = None
        self.restore()

    def restore(self) -> None:
        """Clear all faults, as an operator does; no program plays."""
        with self._lock:
            self.remote, self._mode = True, Mode.RUNNING
            self.safety: int = Safety.NORMAL
            self._runtime: int = Runtime.STOPPED
            self._fraction, self._wrong_tool = 1.0, False
            self._end_program()
            self._motion.override(1.0)

    def slide(self, fraction: float) -> None:
        with self._lock:
            self._fraction = fraction
            self._motion.override(fraction)

    def state(self) -> Values:
        """Return the outputs of one cycle by name; advances a motion."""
        with self._lock:
            self._apply_motion_faults()
            self._run()
            values = self._values()
            stale = self._faults.strikes("robot.stale_position")
            if stale and self._stale is not None:
                values |= self._stale
            kept = ("timestamp", "actual_q", "actual_qd", "actual_TCP_pose")
            self._stale = {name: values[name] for name in kept}
            bad = self._faults.take("robot.bad_number")
            if bad is not None:
                values["actual_q"] = np.array([float(bad), *np.ravel(values["actual_q"])[1:]])
            return values

    def robot_state(self) -> bytes:
        """Return a robot state of the secondary client: the tool and the joint limits.

        Cartesian Info is sub-package 4, Configuration Data 6; values that nobody reads are 0.
        """
        limits_rad = np.radians(self._arm.limits_deg).ravel()
        cartesian, more = struct.pack("!12d", *np.zeros(6), *self._tcp), bytes(440 - 96)
        parts = ((4, cartesian), (6, struct.pack("!12d", *limits_rad) + more))
        body = b"".join(struct.pack("!iB", 5 + len(part), kind) + part for kind, part in parts)
        return struct.pack("!iB", 5 + len(body), 16) + body

    def write(self, values: dict[str, float]) -> None:
        life = "input_int_register_26"  # the PC's sign
        with self._lock:
            self._apply_request_faults()
            changed = {name for name, value in values.items() if self.inputs[name] != value}
            self.inputs |= values
            if life in changed:
                self._timer.set_ms(-self.LIFE_MS)
            self._run()
            if self._session and self._runtime == Runtime.STOPPED:
                self._time.advance(self.STEP_S)  # the PC polls for the end of its session
            # An exchange takes time, which only passes here; a sign of life takes none, for a slow
            # PC sends more of them.
            if self._time.followed and changed != {life}:
                self._motion.poll()

    def play(self, script: str) -> None:
        """Replace the program; ignored in local control and after a stop."""
        with self._lock:
            self._apply_request_faults()
            name = self.NAME.match(script)
            ready = self._mode == Mode.RUNNING and self.safety in (Safety.NORMAL, Safety.REDUCED)
            if not self.remote or not ready or not name:
                return
            self._end_program()
            self._program, self._runtime = name[1], Runtime.PLAYING
            session = self.SESSION.search(script)
            if self._program == "hilcell" and session:
                self._session = int(session[1])
                self._acknowledged = int(self.inputs["input_int_register_24"])
                self._error = Error.OK

    def ask(self, command: str) -> str:
        with self._lock:
            self._apply_request_faults()
            if command == "stop":
                if not self.remote:
                    return "Failed to execute: stop"
                self._end_program()
                return "Stopped"
            known = self.safety in Safety.__members__.values()
            safety = Safety(self.safety).name if known else "UNDEFINED"
            answers = {
                "robotmode": f"Robotmode: {self._mode.name}",
                "safetystatus": f"Safetystatus: {safety}",
                "is in remote control": str(self.remote).lower(),
                "running": f"Program running: {str(self._runtime == Runtime.PLAYING).lower()}",
                "programState": f"{Runtime(self._runtime).name} {self._program or 'null'}",
                "get serial number": str(self._arm.serial),
                "PolyscopeVersion": "URSoftware 5.12.0.1101319 (Mar 22 2022)",
            }
            if command == "get robot model":
                other = self._faults.take("robot.wrong_identity")
                if other is None:
                    return f"{self._arm.model} SIMULATED"
                return "UR5" if other is True else str(other)
            return answers.get(command, f"could not understand: {command!r}")

    # -- the outputs --------------------------------------------------------------------------

    def _values(self) -> Values:
        now_s = self._time.now_s()
        state = self._motion.state(now_s)  # at the package's time, however busy this PC is
        joints_rad, speeds = state.joints_rad, np.zeros(6)
        dither_rad, dither_rad_s = 5e-6, 4e-4  # of a joint that holds
        if state.moving:
            before_rad, now_rad = self._motion.past(np.array([now_s - self.STEP_S, now_s]))[0]
            speeds = (now_rad - before_rad) / self.STEP_S
        else:
            landed = state.joints_rad.tobytes() + state.landing_rad.tobytes()
            off = readout_noise(landed, round(now_s / self.STEP_S), 12)
            joints_rad, speeds = joints_rad + dither_rad * off[:6], dither_rad_s * off[6:]
        T = self._arm.chain.pose(joints_rad)
        pose = np.concatenate([T[:3, 3] / 1000.0, rotation_vector(T[:3, :3])])
        if self._faults.strikes("robot.wrong_tool"):
            self._wrong_tool = True
        tool = np.zeros(6) if self._wrong_tool else self._tcp
        found: Values = {
            "timestamp": now_s,
            "actual_q": joints_rad,
            "target_q": state.joints_rad,
            "actual_qd": speeds,
            "actual_TCP_pose": pose,
            "robot_mode": self._mode,
            "safety_status": self.safety,
            "safety_mode": self.safety,
            "runtime_state": self._runtime,
            "target_speed_fraction": self._fraction,
            "speed_scaling": self._fraction,
            "output_int_register_24": self._acknowledged,
            "output_int_register_25": self._error,
            "output_int_register_26": self._session,
            "output_int_register_27": self._count,
        }
        registers = zip(range(24, 30), tool, strict=True)
        found |= {f"output_double_register_{n}": float(value) for n, value in registers}
        return found | self.inputs

    # -- the program --------------------------------------------------------------------------

    @property
    def _hilcell_plays(self) -> bool:
        return self._program == "hilcell" and self._runtime == Runtime.PLAYING

    def _run(self) -> None:
        if not self._hilcell_plays:
            return
        self._count += 1
        stop = self.inputs["input_int_register_27"] != 0
        if self._in_motion:
            if stop:
                self._brake(Error.BRAKED)
            elif not self._motion.moving and not self._frozen:
                self._acknowledge(Error.OK)
        elif self.inputs["input_int_register_24"] != self._acknowledged:
            error = Error.BRAKED if stop else self._start()
            if error != Error.OK:
                self._acknowledge(error)
        if self.inputs["input_int_register_27"] == self._session:
            self._end_program()

    def _start(self) -> int:
        speed_rad_s = self.inputs["input_double_register_30"]
        move_joints = 1
        if self.inputs["input_int_register_25"] != move_joints or not speed_rad_s > 0.0:
            return Error.UNKNOWN_COMMAND
        target = [self.inputs[f"input_double_register_{n}"] for n in range(24, 30)]
        target_deg = np.degrees(target)
        low_deg, high_deg = self._arm.limits_deg.T
        inside = (target_deg >= low_deg) & (target_deg <= high_deg)
        if not inside.all() or self._faults.strikes("robot.softlimit"):
            return Error.OUT_OF_LIMITS
        motion = apply_start_faults(self._faults, self._truth, target_deg)
        self._acknowledge_lost, self._frozen = motion.acknowledge_lost, motion.frozen
        self._in_motion = True
        if not self._frozen:
            to_rad = np.radians(motion.target_deg)
            way_rad = np.abs(to_rad - self._motion.state().joints_rad)
            slowest_s = float(np.max(way_rad / self._full_rad_s))
            wanted_s = float(np.max(way_rad)) / speed_rad_s
            self._motion.move(to_rad, min(1.0, slowest_s / wanted_s) if wanted_s > 0 else 1.0)
        self._timer.start(-self.LIFE_MS)
        return Error.OK

    def _acknowledge(self, error: int) -> None:
        if not self._acknowledge_lost:
            self._timer.stop()
            self._in_motion, self._error = False, error
            self._acknowledged = int(self.inputs["input_int_register_24"])

    def _brake(self, why: int) -> None:
        self._motion.brake()
        self._acknowledge_lost = self._frozen = False
        self._acknowledge(why)

    def _end_program(self) -> None:
        self._timer.stop()
        if self._motion.moving:
            self._motion.brake()
        self._program, self._runtime = "", Runtime.STOPPED
        self._in_motion = self._acknowledge_lost = self._frozen = False

    def _watchdog_expired(self) -> None:
        """Brake a motion without a sign of life in time; called by the timer's thread."""
        with self._lock:
            self._run()  # the motion may have ended meanwhile
            if self._timer.expired and self._in_motion:
                self._brake(Error.LOST)

    # -- faults -------------------------------------------------------------------------------

    def _apply_request_faults(self) -> None:
        if self._faults.strikes("robot.mode_t1"):
            self.remote = False
            self._end_program()
        if self._faults.strikes("robot.deselected"):
            self._end_program()
        if self._faults.strikes("robot.restarted"):
            self._end_program()
            self._mode, self._session = Mode.BOOTING, 0

    def _apply_motion_faults(self) -> None:
        """Apply the faults of a moving robot, and advance the motion."""
        strikes = partial(self._faults.strikes, moving=self._motion.axes_moving)
        if strikes("robot.vanish"):
            raise Vanished
        if strikes("robot.e_stop"):
            self._end_program()
            self._mode, self.safety = Mode.POWER_OFF, Safety.ROBOT_EMERGENCY_STOP
        if strikes("robot.stopmess"):
            self._motion.brake()
            self._timer.stop()
            self.safety, self._runtime = Safety.PROTECTIVE_STOP, Runtime.PAUSED
        if strikes("robot.override_zero"):
            self.slide(0.0)
        if not self._time.followed:
            self._motion.poll()


class Package(IntEnum):
    """Types of packages."""

    VERSION = 86
    CONTROLLER = 118
    OUTPUTS = 79
    INPUTS = 73
    START = 83
    PAUSE = 80
    DATA = 85


TYPES = {  # of the outputs, beside the registers that a client writes
    **dict.fromkeys(("actual_q", "target_q", "actual_qd", "actual_TCP_pose"), "VECTOR6D"),
    **dict.fromkeys(("robot_mode", "safety_status", "safety_mode"), "INT32"),
    **dict.fromkeys((f"output_int_register_{n}" for n in range(24, 28)), "INT32"),
    "runtime_state": "UINT32",
    **dict.fromkeys(("timestamp", "target_speed_fraction", "speed_scaling"), "DOUBLE"),
    **dict.fromkeys((f"output_double_register_{n}" for n in range(24, 30)), "DOUBLE"),
}


class _Session:
    HEAD = struct.Struct("!HB")
    FASTEST_HZ = 500.0

    def __init__(self, client: socket.socket, server: UrServer) -> None:
        self._client, self._server = client, server
        self._segments = Segments(client.sendall)
        self._pending, self._glued, self._sent = b"", b"", 0
        self._outputs: list[str] = []
        self._layout = struct.Struct("!B")  # of a state
        self._inputs: dict[int, list[tuple[str, str]]] = {}  # by the number of their recipe
        self._writes = False
        self._rate_hz, self._started, self._due_s, self._silent = self.FASTEST_HZ, False, 0.0, False

    def serve(self) -> None:
        try:
            while self._step():
                pass
        finally:
            if self._writes:
                self._server.writer.release()

    def _step(self) -> bool:
        """Answer a request, or send a state when it is due; return whether to continue."""
        wait_s = max(0.0, self._due_s - time.monotonic()) if self._started else None
        ready, _, _ = select.select([self._client], [], [], wait_s)
        if ready:
            data = self._client.recv(RECEIVE)
            return bool(data) and self._take(data)
        stepped_s = 0.002  # between two states, in stepped time
        paced_s = 1.0 / min(self._rate_hz, self.FASTEST_HZ)
        self._due_s = time.monotonic() + (stepped_s if self._server.time.stepped else paced_s)
        self._send_state()
        return True

    def _take(self, data: bytes) -> bool:
        self._pending += data
        while len(self._pending) >= self.HEAD.size:
            size, kind = self.HEAD.unpack_from(self._pending)
            if size < self.HEAD.size:
                return False
            if len(self._pending) < size:
                break
            payload, self._pending = self._pending[self.HEAD.size : size], self._pending[size:]
            if not self._answer(kind, payload):
                return False
        return True

    def _answer(self, kind: int, payload: bytes) -> bool:
        if kind == Package.DATA:
            return self._write(payload)
        software = (5, 12, 0, 1101319)
        if kind == Package.VERSION:
            answer = b"\x01" if payload in (b"\x00\x01", b"\x00\x02") else b"\x00"
        elif kind == Package.CONTROLLER:
            answer = struct.pack("!4I", *software)
        elif kind == Package.OUTPUTS:
            (self._rate_hz,) = struct.unpack_from("!d", payload)
            self._outputs = _names(payload[8:])
            layouts = {"VECTOR6D": "6d", "DOUBLE": "d", "INT32": "i", "UINT32": "I"}
            known = TYPES | {name: self._register(name) for name in self._server.controller.inputs}
            types = [known.get(name, "NOT_FOUND") for name in self._outputs]
            self._layout = struct.Struct("!B" + "".join(layouts.get(each, "") for each in types))
            answer = b"\x01" + ",".join(types).encode()
        elif kind == Package.INPUTS:
            number, types = self._input_recipe(_names(payload))
            answer = bytes([number]) + ",".join(types).encode()
        elif kind in (Package.START, Package.PAUSE):
            self._started, answer = kind == Package.START, b"\x01"
        else:
            return True
        self._client.sendall(self.HEAD.pack(self.HEAD.size + len(answer), kind) + answer)
        return True

    def _input_recipe(self, names: list[str]) -> tuple[int, list[str]]:
        """Return the number of a new recipe, 0 if it is refused, and its types."""
        self._writes = self._writes or self._server.writer.acquire(blocking=False)
        known = self._server.controller.inputs
        types = [
            "NOT_FOUND" if name not in known else self._register(name) if self._writes else "IN_USE"
            for name in names
        ]
        if not set(types) <= {"INT32", "DOUBLE"}:
            return 0, types
        number = len(self._inputs) + 1
        self._inputs[number] = list(zip(names, types, strict=True))
        return number, types

    def _write(self, payload: bytes) -> bool:
        strikes = self._server.faults.strikes
        if strikes("robot.idle_close"):
            return False
        if strikes("robot.half_open") or strikes("robot.no_reply"):
            self._silent = True
        recipe = self._inputs.get(payload[0], []) if payload else []
        layout = "!B" + "".join("i" if kind == "INT32" else "d" for _, kind in recipe)
        if len(payload) == struct.calcsize(layout) > 1:
            values = struct.unpack(layout, payload)[1:]
            names = (name for name, _ in recipe)
            self._server.controller.write(dict(zip(names, values, strict=True)))
            self._server.time.catch_up()
        return True

    def _send_state(self) -> None:
        values = self._server.controller.state()
        if self._silent:
            return
        faults = self._server.faults
        late_s = faults.number("robot.late_reply")
        if late_s is not None:
            time.sleep(late_s)
        number = 2 if faults.strikes("robot.tag_mismatch") else 1
        numbers: list[float] = []
        for name in self._outputs:
            value = values[name]
            numbers += value.tolist() if isinstance(value, np.ndarray) else [value]
        payload = self._layout.pack(number, *numbers)
        package = (
            self._glued + self.HEAD.pack(self.HEAD.size + len(payload), Package.DATA) + payload
        )
        self._sent += 1
        glued_every, glued, self._glued = 29, self._glued, b""
        if faults.strikes("robot.split_reply"):
            self._segments.send_in_two(package, len(package) // 2)
        elif self._sent % glued_every == 0 and not glued:
            self._glued = package
        else:
            self._segments.send(package)

    @staticmethod
    def _register(name: str) -> str:
        return "INT32" if "_int_" in name else "DOUBLE"


def _names(payload: bytes) -> list[str]:
    """Return the names of a request, without a trailing comma."""
    return payload.decode("ascii", "replace").removesuffix(",").split(",")


class UrServer(Server):
    """Serves one controller; only the port of RTDE can be chosen."""

    def __init__(self, site: Site, port: int = 0) -> None:
        self.controller, self.faults, self.time = UrController(site), site.faults, site.time
        self.writer = threading.Lock()  # held for the one client that may write registers
        listeners = {
            "rtde_port": Listener("rtde", lambda client: _Session(client, self).serve(), port=port),
            "script_port": Listener("scripts", self._serve_scripts),
            "dashboard_port": Listener("dashboard", self._serve_dashboard),
        }
        ports = {name: each.port for name, each in listeners.items()}
        address = {"host": HOST, **ports}
        super().__init__(address, *listeners.values(), restore=self.controller.restore)

    def _serve_scripts(self, client: socket.socket) -> None:
        """Play what a client sends, when its ``def`` has reached its ``end``."""
        text = ""
        state_s = 0.1  # the script port sends a state so often, read or not
        longest = 200_000
        while True:
            ready, _, _ = select.select([client], [], [], state_s)
            if not ready:
                with contextlib.suppress(BlockingIOError):
                    client.send(self.controller.robot_state(), socket.MSG_DONTWAIT)
                continue
            data = client.recv(RECEIVE)
            text += data.decode("ascii", "replace")
            if not data or len(text) > longest:
                return
            if text.endswith("\nend\n"):
                self.controller.play(text)
                text = ""

    def _serve_dashboard(self, client: socket.socket) -> None:
        greeting = b"Connected: Universal Robots Dashboard Server\n"
        client.sendall(greeting)
        with client.makefile("rb") as lines:
            while line := lines.readline(RECEIVE):
                command = line.decode("ascii", "replace").strip()
                if command == "quit":
                    client.sendall(b"Disconnected\n")
                    return
                client.sendall(self.controller.ask(command).encode() + b"\n")


serve = UrServer
