"""A simulated robot of Mecademic, on the real wire: it moves the arm of the simulated cell.

Written from the maker's manual, and from nothing of the driver. Motion commands go into a queue,
which runs while the robot is not paused and stands; all other commands are answered at once.
"""

from __future__ import annotations

import re
import select
import socket
import threading
from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np

from fakes.faults import Vanished
from fakes.site import Site
from fakes.time import WatchdogTimer
from fakes.truth.cell_truth import apply_start_faults
from fakes.truth.machine import controller_arm
from fakes.truth.noise import readout_noise
from fakes.wires import HOST, Listener, Segments
from hilcell.ports import Array

COMMAND = re.compile(r"(\w+)\s*(?:\(([^()]*)\))?", re.ASCII)
DITHER_DEG = 2e-4  # of a joint that holds
TICK_S = 0.01
HANDOVER_S = 0.2  # until a connection that was lost is given up
RECEIVE = 4096


class MecaController:
    """One robot's controller; its methods may come from several threads."""

    def __init__(self, site: Site) -> None:
        self._lock = threading.RLock()
        self._motion, self._faults, self._time = site.truth.robot, site.faults, site.time
        self._truth = site.truth
        self._arm = controller_arm(site.cell)
        self._smr_mm = np.array(site.cell.robot.smr_mm)
        self._low_deg = np.array([joint.min_deg for joint in site.cell.robot.joint])
        self._high_deg = np.array([joint.max_deg for joint in site.cell.robot.joint])
        self._watchdog = WatchdogTimer(self._connection_lost)
        self._queue = deque[tuple[str, Array]]()
        self._messages = list[str]()  # that nobody has asked for
        self._frames = {"wrf": np.zeros(6), "trf": np.zeros(6)}
        self._share, self._looks, self._guarded, self._frozen = 0.25, 0, False, False
        self._motion.brake()  # it stands where it was switched on
        self.restore()

    def restore(self) -> None:
        """The operator puts everything right: activated, homed, no error."""
        with self._lock:
            self.activated = self.homed = True
            self.simulates = self.error = self._paused = False

    def answer(self, line: str) -> list[str]:
        """Return the messages that a command brings; raises `Vanished`."""
        match = COMMAND.fullmatch(line.strip())
        if match is None:
            return [f"[1002][Syntax error. - Command: '{line[:80]}']"] if line.strip() else []
        try:
            values = np.array([float(word) for word in (match[2] or "").split(",") if word.strip()])
        except ValueError:
            return [f"[1003][Argument error. - Command: '{line[:80]}']"]
        name = match[1].lower()
        with self._lock:
            if name in MOTIONS:
                return [*self._enqueue(name, values), *self.messages()]
            if name not in REQUESTS:
                return [f"[1001][Empty command or command unrecognized. - Command: '{line[:80]}']"]
            return [*getattr(self, f"_on_{name}")(values), *self.messages()]

    def messages(self) -> list[str]:
        """Return the messages that nobody has asked for."""
        with self._lock:
            self._run()
            found, self._messages = self._messages, []
            return found

    def disconnected(self) -> None:
        """The client is gone: a robot in motion stops."""
        with self._lock:
            self._run()
            self._watchdog.stop()
            self._guarded = False
            self._messages.clear()
            if self._motion.moving:
                self._safety_stop()

    # -- requests -----------------------------------------------------------------------------

    def _on_getproducttype(self, _: Array) -> list[str]:
        other = self._faults.take("robot.wrong_identity")
        return [f"[2084][{'Meca500 SIMULATED' if other is None else other}]"]

    def _on_getrobotserial(self, _: Array) -> list[str]:
        return [f"[2083][m500-{self._arm.serial}]"]

    def _on_getfwversion(self, _: Array) -> list[str]:
        return ["[2081][v11.3.4]"]

    def _on_synccmdqueue(self, values: Array) -> list[str]:
        return [f"[2097][{values[0]:.0f}]"]

    def _on_getwrf(self, _: Array) -> list[str]:
        return [f"[2013][{_text(self._frames['wrf'])}]"]

    def _on_gettrf(self, _: Array) -> list[str]:
        return [f"[2014][{_text(self._frames['trf'])}]"]

    def _on_getstatusrobot(self, _: Array) -> list[str]:
        self._strike()
        self._motion.poll()  # each poll lets simulated time pass
        self._run()
        stands = not self._motion.moving and not self._frozen
        ended = stands and not self._queue
        states = (
            self.activated, self.homed, self.simulates, self.error, self._paused, ended, stands
        )  # fmt: skip
        return [f"[2007][{','.join(str(int(each)) for each in states)}]"]

    def _on_getrtjointpos(self, _: Array) -> list[str]:
        return [f"[2210][{self._time_us():.0f},{_text(self._joints_deg())}]"]

    def _on_getrtcartpos(self, _: Array) -> list[str]:
        pose = self._arm.chain.pose(np.radians(self._joints_deg()))
        trf_mm = self._frames["trf"][:3]
        place = pose[:3, 3] + pose[:3, :3] @ (trf_mm - self._smr_mm)
        numbers = np.concatenate([place, _angles_deg(pose[:3, :3])])
        return [f"[2211][{self._time_us():.0f},{_text(numbers)}]"]

    def _on_clearmotion(self, _: Array) -> list[str]:
        self._halt()
        return ["[2044][The motion was cleared.]"]

    def _on_resumemotion(self, _: Array) -> list[str]:
        self._paused = self.error
        return ["[2043][Motion resumed.]"]

    def _on_connectionwatchdog(self, values: Array) -> list[str]:
        first, self._guarded = not self._guarded, bool(values[0] > 0.0)
        if not self._guarded:
            self._watchdog.stop()
            return ["[2177][0]"]
        self._watchdog.start(round(-1000.0 * float(values[0])))
        return ["[2177][1]"] if first else []

    # -- motions ------------------------------------------------------------------------------

    def _enqueue(self, name: str, values: Array) -> list[str]:
        if not self.activated or self.error:
            return ["[1011][The robot is in error.]" if self.error else "[1005][Not activated.]"]
        self._queue.append((name, values))
        self._run()
        return []

    def _run(self) -> None:
        """Work the queue off, as far as it goes."""
        while self._queue and not (
            self._paused or self.error or self._motion.moving or self._frozen
        ):
            name, values = self._queue.popleft()
            if name == "movejoints":
                self._move(values)
            elif name == "setjointvel":
                self._share = float(values[0]) / 100.0
            elif name in ("setwrf", "settrf"):
                self._frames[name.removeprefix("set")] = values
            elif name == "setcheckpoint":
                self._messages.append(f"[3030][{values[0]:.0f}]")

    def _move(self, target_deg: Array) -> None:
        inside = (target_deg >= self._low_deg) & (target_deg <= self._high_deg)
        if not inside.all() or self._faults.take("robot.softlimit") is not None:
            self._messages.append("[1007][The requested joint set is over the joint limits.]")
            self.error = True
            self._halt()
            return
        motion = apply_start_faults(self._faults, self._truth, target_deg)
        self._looks, self._frozen = 0, motion.frozen
        if not motion.frozen:
            self._motion.move(np.radians(motion.target_deg), self._share)

    def _halt(self) -> None:
        """Brake, forget the queue and take no motion before it is resumed."""
        self._watchdog.stop()
        self._queue.clear()
        self._motion.brake()
        self._paused, self._frozen = True, False

    def _safety_stop(self) -> None:
        self._halt()
        self._messages.append("[3086][1]")

    def _connection_lost(self) -> None:
        """Stop: the client has not spoken in time; called by the watchdog's thread."""
        with self._lock:
            if self._watchdog.expired:
                self._safety_stop()

    def _strike(self) -> None:
        """Let the faults of a moving robot happen."""
        take = partial(self._faults.take, moving=self._motion.axes_moving)
        if take("robot.vanish") is not None:
            raise Vanished
        if take("robot.e_stop") is not None:
            self._halt()
            self.activated = self.homed = False
            self._messages.append("[3070][1]")

    # -- where it is --------------------------------------------------------------------------

    def _joints_deg(self) -> Array:
        state = self._motion.state()
        joints_deg: Array = np.degrees(state.joints_rad)
        if state.moving:
            return joints_deg
        self._looks += 1
        landed = state.joints_rad.tobytes() + state.landing_rad.tobytes()
        return joints_deg + DITHER_DEG * readout_noise(landed, self._looks, 6)

    def _time_us(self) -> float:
        return self._time.now_s() * 1e6


MOTIONS = ("movejoints", "setjointvel", "setwrf", "settrf", "setblending", "setcheckpoint")
REQUESTS = tuple(
    name.removeprefix("_on_") for name in vars(MecaController) if name.startswith("_on_")
)


class MecaServer:
    """Serves one controller on its control port: one client at a time."""

    def __init__(self, site: Site, port: int) -> None:
        self.controller = MecaController(site)
        self._listener = Listener("meca500", self._serve, port=port)
        self._free = threading.Semaphore()

    @property
    def address(self) -> dict[str, object]:
        """Return where it listens, as options of the driver."""
        return {"host": HOST, "port": self._listener.port}

    def start(self) -> None:
        """Begin to serve."""
        self._listener.start()

    def restore(self) -> None:
        """Put the controller right, as an operator does."""
        self.controller.restore()

    def close(self) -> None:
        """Stop serving."""
        self._listener.close()

    def _serve(self, client: socket.socket) -> None:
        if not self._free.acquire(timeout=HANDOVER_S):
            client.sendall(b"[3001][Another user is already connected, closing connection.]\0")
            return
        try:
            self._talk(client, Segments(client.sendall).send)
        finally:
            self.controller.disconnected()
            self._free.release()

    def _talk(self, client: socket.socket, send: Callable[[bytes], None]) -> None:
        send(b"[3000][Connected to Meca500 SIMULATED v11.3.4.]\0")
        pending = b""
        while True:
            answers = list[str]()
            ready, _, _ = select.select([client], [], [], TICK_S)
            if ready:
                data = client.recv(RECEIVE)
                *lines, pending = (pending + data).split(b"\0")
                for line in lines:
                    answers += self.controller.answer(line.decode("ascii", "replace"))
                if not data:
                    return
            answers += self.controller.messages()
            if answers:
                send("".join(f"{each}\0" for each in answers).encode())


def serve(site: Site, port: int) -> MecaServer:
    """Return the robot of a simulated cell behind the text API."""
    return MecaServer(site, port)


def _angles_deg(R: Array) -> Array:
    """Return alpha, beta, gamma of R = Rx(alpha) Ry(beta) Rz(gamma)."""
    b = np.arcsin(np.clip(R[0, 2], -1.0, 1.0))
    if abs(R[0, 2]) > 1.0 - 1e-12:
        return np.degrees([np.arctan2(R[2, 1], R[1, 1]), b, 0.0])
    return np.degrees([np.arctan2(-R[1, 2], R[2, 2]), b, np.arctan2(-R[0, 1], R[0, 0])])


def _text(numbers: Array) -> str:
    return ",".join(f"{each:.6f}" for each in numbers)
