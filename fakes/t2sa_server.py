"""SpatialAnalyzer's bridge T2SA with an API tracker behind it: text lines over TCP.

Points are identified by collection, group and name. For a measurement the tracker points at a
point's nominal position, searches the reflector nearest to that direction, locks on and measures;
the nominal point does not change. The laser is off at first, and needs to warm up.

There is one measurement at a time; meanwhile every connection gets "busy". A halt aborts it: first
the measurement is answered with an error, then the halt.
"""

from __future__ import annotations

import csv
import math
import socket
import tempfile
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import Enum
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from fakes.faults import Vanished
from fakes.site import Site
from fakes.truth.transforms import Array, frame, inverse
from fakes.wires import HOST, Connection, LineSession, Listener, Server
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError


class Refusal(Enum):
    """Codes of refused requests, and their texts."""

    REJECTED = 200, "Command rejected."
    BUSY = 201, "Command rejected. SA is busy."
    NOT_MEASURED = 305, "Measurement of point failed."
    NO_POINT = 306, "Did not find or set point group and target name."
    NO_PROFILE = 307, "Requested measurement profile does not exist."
    NO_FRAME = 314, "Working frame not set, not found."
    HALTED = 330, "Measurement halted."
    NOT_SIMULATING = 337, "Failed to set simulation mode."
    NOT_READY = 338, "Instrument is not ready."


@dataclass(frozen=True, slots=True)
class Answer:
    """A reply, perhaps after cell time has passed."""

    line: str = "ACK-300 READY"
    after_s: float = 0.0
    finish: Callable[[], Answer] | None = None
    measured: bool = False


def refusal(refused: Refusal) -> Answer:
    code, words = refused.value
    return Answer(f"ERR-{code} {words}")


class T2saDevice:
    """One bridge with one instrument; ``handle`` takes one request after another."""

    POWER_ON = datetime(2026, 1, 5, 8, 0, tzinfo=UTC)
    WARM_UP_S = 20.0
    POINT_S, SEARCH_S, READ_S = 0.3, 0.8, 0.5
    SEARCH_MM, BEAM_MM = 150.0, 8.0  # off the aim: with the camera, and without

    def __init__(self, site: Site, points: Mapping[str, Array]) -> None:
        """``points`` (3,) are those of the cell file's group, by name."""
        self._instrument, self._faults = site.truth.tracker, site.faults
        self._time, options = site.truth.time, site.cell.tracker.options
        self._points = points
        self._group = f"{options.get('collection', 'A')};{options.get('group', 'HILCELL')}"
        self._warm_s: float | None = None
        self._window_mm = self.SEARCH_MM
        self._former_mm: Array | None = None
        handlers: dict[str, Callable[[str], Answer]] = {
            "!LST": self._switch,
            "!MEAS_SINGLE_POINT": self._measure,
            "!SET_SIM": self._simulate,
            "!SET_WORKING_FRAME": lambda name: refusal(
                Refusal.NO_FRAME if name else Refusal.REJECTED
            ),
            "!SINGLE_POINT_MEAS_PROFILE": self._choose_profile,
            "?LSTA": lambda _: Answer(f"ACK-300 {self._laser()}"),
            "?POINT_POS": self._position,
            "?STAT": lambda _: Answer("ACK-300 Instrument is connected (simulated)"),
            "SET_POWER_LOCK": self._set_power_lock,
        }
        kept = (
            "!SET_STATION_LOCK",
            "SET_NUM_SAMPLES",
            "SET_NUM_ITERATIONS",
            "SET_RANDOMIZE_POINTS",
        )
        self._handlers = handlers | dict.fromkeys(kept, lambda _: Answer())

    def handle(self, line: str) -> Answer:
        name, _, values = line.partition(":")
        handler = self._handlers.get(name)
        return refusal(Refusal.REJECTED) if handler is None else handler(values)

    def _switch(self, value: str) -> Answer:
        if value not in ("0", "1"):
            return refusal(Refusal.REJECTED)
        on = value == "1"
        if not on:
            self._warm_s = None
        elif self._warm_s is None:
            self._warm_s = self._time.now_s() + self.WARM_UP_S
        return Answer(f"ACK-300 Tracker Interface {'Started' if on else 'Stopped'}: True")

    def _laser(self) -> str:
        if self._warm_s is None:
            return "LOFF"
        left_s = self._warm_s - self._time.now_s()
        return f"WARM, {left_s:.2f} seconds" if left_s > 0 else "LON"

    def _simulate(self, value: str) -> Answer:
        if value != "0" or self._faults.strikes("tracker.t2sa_simulation"):
            return refusal(Refusal.NOT_SIMULATING)
        return Answer("ACK-300 Set 0")

    def _choose_profile(self, name: str) -> Answer:
        profiles = ("Single Pt. To SA", "Standard Pt. To SA")
        if name not in profiles:
            return refusal(Refusal.NO_PROFILE)
        return Answer(f"ACK-300 Single Point Measurement Profile set to {name}")

    def _set_power_lock(self, value: str) -> Answer:
        if value not in ("0", "1"):
            return refusal(Refusal.REJECTED)
        self._window_mm = self.SEARCH_MM if value == "1" else self.BEAM_MM
        return Answer()

    def _point(self, path: str) -> Array | None:
        group, _, name = path.rpartition(";")
        if group != self._group or self._faults.strikes("tracker.t2sa_renamed"):
            return None
        return self._points.get(name)

    def _position(self, path: str) -> Answer:
        at_mm = self._point(path)
        if at_mm is None:
            return refusal(Refusal.NO_POINT)
        return Answer(self._result(path, self._to_units(at_mm)))

    def _measure(self, path: str) -> Answer:
        strikes = self._faults.strikes
        if strikes("tracker.vanish"):
            raise Vanished
        if strikes("tracker.busy"):
            return refusal(Refusal.BUSY)
        code = self._faults.number("tracker.t2sa_code")
        if code is not None:
            words = dict(each.value for each in Refusal)
            return Answer(f"ERR-{int(code)} {words.get(int(code), 'Failed.')}")
        if self._laser() != "LON" or strikes("tracker.not_warmed_up"):
            return refusal(Refusal.NOT_READY)
        aim_mm = self._point(path)
        if aim_mm is None:
            return refusal(Refusal.NO_POINT)
        off_mm, name = self._nearest(aim_mm)
        search_s = self.SEARCH_S * min(off_mm, self._window_mm) / self.SEARCH_MM

        def finish() -> Answer:
            return self._measured(path, aim_mm, name)

        return Answer(after_s=self.POINT_S + search_s + self.READ_S, finish=finish)

    def _nearest(self, aim_mm: Array) -> tuple[float, str | None]:
        along = aim_mm / np.linalg.norm(aim_mm)
        inside: list[tuple[float, float, Array]] = []
        for at_mm in self._instrument.reflectors().values():
            range_mm = float(np.linalg.norm(at_mm))
            angle = math.acos(min(1.0, max(-1.0, float(at_mm @ along) / range_mm)))
            if range_mm * math.sin(angle) <= self._window_mm and angle < math.pi / 2:
                inside.append((angle, range_mm * math.sin(angle), at_mm))
        if not inside:
            return self._window_mm, None
        _, off_mm, at_mm = min(inside, key=lambda each: each[0])
        return off_mm, self._instrument.find(at_mm, 1e-3)

    def _measured(self, path: str, aim_mm: Array, name: str | None) -> Answer:
        strikes = self._faults.strikes
        lost = ("tracker.no_reflector", "tracker.beam_break_before", "tracker.beam_break_after")
        if any(strikes(fault) for fault in lost):
            return refusal(Refusal.NOT_MEASURED)
        found = None if name is None else self._instrument.measure(name)
        if found is None:
            return refusal(Refusal.NOT_MEASURED)
        xyz_mm = found.xyz_mm
        if self._former_mm is not None and strikes("tracker.t2sa_old_result"):
            xyz_mm = self._former_mm
        self._former_mm = xyz_mm
        if strikes("tracker.t2sa_nominal"):
            xyz_mm = aim_mm
        text = self._faults.take("tracker.bad_number")
        line = self._result(path, self._to_units(xyz_mm), "" if text is None else str(text))
        return Answer(line, measured=True)

    def _to_units(self, xyz_mm: Array) -> Array:
        inches = self._faults.strikes("tracker.t2sa_inches")
        mm_per_inch = 25.4
        return xyz_mm / mm_per_inch if inches else xyz_mm

    def _result(self, path: str, xyz: Array, x: str = "") -> str:
        """Return the line of a position; its date is in the PC's own format."""
        values = [f"{each:.6f}" for each in xyz]
        values[0] = x or values[0]
        when = self.POWER_ON + timedelta(seconds=self._time.now_s())
        date = when.strftime("%m/%d/%Y %I:%M:%S %p")
        return f"ACK-300 Single Point Measurement {path} result {','.join(values)} {date}"


def read_points(path: Path) -> dict[str, Array]:
    """Return the points (3,) of a CSV file by name; raises `SettingsError`."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.reader(file) if row and row[0] != "name"]
        return {row[0]: np.array([float(each) for each in row[1:4]]) for row in rows}
    except (OSError, ValueError) as error:
        raise SettingsError(
            str(path), [f"SpatialAnalyzer cannot import this list: {error}"]
        ) from error


def target_fan(cell: Cell) -> dict[str, Array]:
    """Return points (3,) in the tracker's frame in all directions of the cell's reflectors.

    A user imports a list into the job and names it in the cell file; in a simulated cell without
    one, this fan over the reach of the arm and the nests replaces it.
    """
    reachable_mm = _reachable_mm(cell)
    # unit vectors (N, 3), evenly spread by the golden angle
    pitch_rad = 0.01
    count = math.ceil(4.0 * math.pi / pitch_rad**2)
    n = np.arange(count)
    z = 1.0 - (2.0 * n + 1.0) / count
    azimuth = n * math.pi * (3.0 - math.sqrt(5.0))
    across = np.sqrt(1.0 - z**2)
    directions = np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), z])
    tree = KDTree(reachable_mm / np.linalg.norm(reachable_mm, axis=1)[:, None])
    wider_rad = 0.1
    beside, _ = tree.query(directions, distance_upper_bound=wider_rad)
    range_mm = 4000.0
    kept = range_mm * directions[np.isfinite(beside)]
    return {f"H{n:06d}": at_mm.round(3) for n, at_mm in enumerate(kept, start=1)}


def write(path: Path, points: dict[str, Array]) -> None:
    with path.open("w", encoding="ascii", newline="") as file:
        csv.writer(file).writerows([name, *map(str, at_mm)] for name, at_mm in points.items())


def _reachable_mm(cell: Cell) -> Array:
    """Return positions (N, 3), tracker's frame, throughout the arm's reach, and the nests."""
    rail, layout = cell.rail, cell.layout
    nests_mm = np.array([nest.xyz_mm for nest in layout.fixed_nests])
    reach_mm = sum(math.hypot(joint.a_mm, joint.d_mm) for joint in cell.robot.joint)
    reach_mm += float(np.linalg.norm(cell.robot.smr_mm))
    sample_mm = 400.0
    axis_mm = np.arange(-reach_mm, reach_mm, sample_mm)
    ball_mm = np.stack(np.meshgrid(axis_mm, axis_mm, axis_mm), -1).reshape(-1, 3)
    ball_mm = ball_mm[np.linalg.norm(ball_mm, axis=1) <= reach_mm]
    ball_mm += [layout.base.x_mm, layout.base.y_mm, layout.base.z_mm]
    stops = 6
    stops_mm = np.linspace(rail.travel_min_mm, rail.travel_max_mm, stops)
    shifts_mm = np.multiply.outer(stops_mm, np.array(layout.rail_direction))
    world_mm = np.vstack([ball_mm + shift_mm for shift_mm in shifts_mm] + [nests_mm])
    world_mm = world_mm[world_mm[:, 2] >= nests_mm[:, 2].min()]
    T = inverse(frame(cell.tracker.pose))
    at_mm = world_mm @ T[:3, :3].T + T[:3, 3]
    found: Array = at_mm[np.linalg.norm(at_mm, axis=1) >= cell.tracker.min_range_mm]
    return found


class T2saServer(Server):
    """Serves one bridge on a port, 0 for one that the system chooses."""

    HALT = b"!HALT"

    def __init__(self, site: Site, port: int = 0) -> None:
        """The points are those of the cell file's list, else of a list of its own."""
        listed = str(site.cell.tracker.options.get("points", ""))
        address: dict[str, str] = {}
        points = read_points(Path(listed)) if listed else target_fan(site.cell)
        self._folder = tempfile.TemporaryDirectory(prefix="t2sa-")
        if not listed:
            address = {"points": str(Path(self._folder.name) / "points.csv")}
            write(Path(address["points"]), points)
        self._device = T2saDevice(site, points)
        self._faults, self._time = site.faults, site.time
        self._requests = threading.Lock()
        self._measuring, self._halted = threading.Lock(), threading.Event()
        listener = Listener("t2sa", self._serve_client, port=port)
        super().__init__({"host": HOST, "port": listener.port, **address}, listener)

    def close(self) -> None:
        super().close()
        self._folder.cleanup()

    def _serve_client(self, client: socket.socket) -> None:
        session = LineSession(Connection(client))
        while True:
            line = session.line(None)
            if line is not None:
                self._obey(session, line)

    def _obey(self, session: LineSession, line: bytes) -> None:
        if line == self.HALT:
            self._halted.set()
            with self._measuring:  # another client's measurement has ended
                self._reply(session, Answer())
            return
        answer = self._begin(line)
        if answer.finish is None:
            self._reply(session, answer)
        else:
            self._measure(session, answer.after_s, answer.finish)

    def _begin(self, line: bytes) -> Answer:
        """Return the first answer to a line; a measurement reserves the bridge."""
        with self._requests:
            if self._measuring.locked():
                return refusal(Refusal.BUSY)
            answer = self._device.handle(line.decode("ascii", "replace"))
            if answer.finish is not None:
                self._measuring.acquire()
                self._halted.clear()
            return answer

    def _measure(
        self, session: LineSession, duration_s: float, finish: Callable[[], Answer]
    ) -> None:
        try:
            halted_by_this = self._let_pass(session, duration_s)
            halted = self._halted.is_set()
            self._reply(session, refusal(Refusal.HALTED) if halted else finish())
        finally:
            self._measuring.release()
        if halted_by_this:
            self._reply(session, Answer())

    def _let_pass(self, session: LineSession, duration_s: float) -> bool:
        """Let cell time pass until a halt; return whether that came from this client."""
        poll_s = 0.02
        for left_s in self._time.passing(duration_s):
            if self._halted.is_set():
                return False
            line = session.line(min(left_s, poll_s))
            if line == self.HALT:
                self._halted.set()
                return True
            if line is not None:
                self._reply(session, refusal(Refusal.BUSY))
        return False

    def _reply(self, session: LineSession, answer: Answer) -> None:
        reply = answer.line.encode("ascii")
        if not answer.measured:
            session.say_late()
            session.say(reply)
        elif self._faults.strikes("tracker.eof"):
            raise ConnectionAbortedError
        elif not self._faults.strikes("tracker.no_result"):
            session.answer(reply, self._faults)


serve = T2saServer
