"""T2SA's lines over TCP: one measurement at a time, and a halt that overtakes it.

While a measurement is under way all else is answered by "busy", on every connection; a halt ends
it, and the measurement is then answered by an error of its own before the halt is.
"""

from __future__ import annotations

import csv
import math
import socket
import tempfile
import threading
import time as real_time
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from fakes.faults import Faults, Vanished
from fakes.site import Site
from fakes.spatialanalyzer.t2sa_device import Answer, Refusal, T2saDevice, refusal
from fakes.time import PlantTime
from fakes.truth.transforms import Array, frame, inverse
from fakes.wires.line_session import Connection, LineSession
from fakes.wires.listener import HOST, Listener
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError

# A person would import a list into the job, and name it in the cell file. In a simulated cell
# whose file names none, a fan towards all that the arm and the nests can reach is both.


def imported(path: Path) -> dict[str, Array]:
    """Return the points (3,) of a CSV file by name; raises `SettingsError`."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.reader(file) if row and row[0] != "name"]
        return {row[0]: np.array([float(each) for each in row[1:4]]) for row in rows}
    except (OSError, ValueError) as error:
        raise SettingsError(
            str(path), [f"SpatialAnalyzer imports no such list: {error}"]
        ) from error


def fan(cell: Cell) -> dict[str, Array]:
    """Return points (3,) in the tracker's frame in all directions of the cell's reflectors."""
    ways = _ways_mm(cell)
    directions = _directions()
    tree = KDTree(ways / np.linalg.norm(ways, axis=1)[:, None])
    wider_rad = 0.1
    beside, _ = tree.query(directions, distance_upper_bound=wider_rad)
    range_mm = 4000.0
    kept = range_mm * directions[np.isfinite(beside)]
    return {f"H{n:06d}": at_mm.round(3) for n, at_mm in enumerate(kept, start=1)}


def write(path: Path, points: dict[str, Array]) -> None:
    """Write the list as a person would name it in the cell file."""
    with path.open("w", encoding="ascii", newline="") as file:
        csv.writer(file).writerows([name, *map(str, at_mm)] for name, at_mm in points.items())


def _ways_mm(cell: Cell) -> Array:
    """Return places (N, 3), tracker's frame, throughout the arm's reach, and the nests."""
    rail, layout = cell.rail, cell.layout
    nests_mm = np.array([nest.xyz_mm for nest in layout.standing])
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


def _directions() -> Array:
    """Return unit vectors (N, 3), evenly spread by the golden angle."""
    pitch_rad = 0.01
    count = math.ceil(4.0 * math.pi / pitch_rad**2)
    n = np.arange(count)
    z = 1.0 - (2.0 * n + 1.0) / count
    turn = n * math.pi * (3.0 - math.sqrt(5.0))
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


HALT = b"!HALT"
COLLECTION, GROUP = "A", "HILCELL"


class T2saServer:
    """Serves one bridge on a port, 0 for one that the system chooses."""

    def __init__(
        self,
        device: T2saDevice,
        faults: Faults,
        time: PlantTime,
        *,
        port: int = 0,
        folder: tempfile.TemporaryDirectory[str] | None = None,
        points: str = "",
    ) -> None:
        """``folder`` is removed at the end; ``points`` in it is the list that was imported."""
        self._device, self._faults, self._time = device, faults, time
        self._folder, self._points = folder, points
        self._turn = threading.Lock()
        self._measuring, self._halted = threading.Lock(), threading.Event()
        self._listener = Listener("t2sa", self._serve_client, port=port)

    @property
    def address(self) -> dict[str, object]:
        """Return where it listens, as options of the driver, and the list of its points."""
        found: dict[str, object] = {"host": HOST, "port": self._listener.port}
        return found | ({"points": self._points} if self._points else {})

    def start(self) -> None:
        """Begin to serve."""
        self._listener.start()

    def restore(self) -> None:
        """Leave the bridge as it is: its faults pass by themselves."""

    def close(self) -> None:
        """Stop serving."""
        self._listener.close()
        if self._folder is not None:
            self._folder.cleanup()

    def _serve_client(self, client: socket.socket) -> None:
        session = LineSession(Connection(client))
        try:
            while True:
                line = session.line(None)
                if line is not None:
                    self._obey(session, line)
        except Vanished:
            self._listener.hang_up()

    def _obey(self, session: LineSession, line: bytes) -> None:
        if line == HALT:
            self._halted.set()
            with self._measuring:  # another client's measurement has ended
                self._reply(session, Answer())
        elif (answer := self._begin(line)).finish is None:
            self._reply(session, answer)
        else:
            try:
                halted = self._answer(session, answer)
            finally:
                self._measuring.release()
            if halted:
                self._reply(session, Answer())

    def _begin(self, line: bytes) -> Answer:
        """Return the first answer to a line; a measurement reserves the bridge."""
        with self._turn:
            if self._measuring.locked():
                return refusal(Refusal.BUSY)
            answer = self._device.handle(line.decode("ascii", "replace"))
            if answer.finish is not None:
                self._measuring.acquire()
                self._halted.clear()
            return answer

    def _answer(self, session: LineSession, answer: Answer) -> bool:
        """Reply, after plant time where that is due; return whether this client has halted it."""
        while answer.finish is not None:
            by_this = self._let_pass(session, answer.after_s)
            if self._halted.is_set():
                self._reply(session, refusal(Refusal.HALTED))
                return by_this
            answer = answer.finish()
        self._reply(session, answer)
        return False

    def _let_pass(self, session: LineSession, duration_s: float) -> bool:
        """Let plant time pass until a halt; return whether that came from this client."""
        if self._time.stepped:
            self._time.advance(duration_s)
            return False
        ends_s = real_time.monotonic() + duration_s / self._time.speed
        look_s = 0.02
        while not self._halted.is_set() and (left_s := ends_s - real_time.monotonic()) > 0:
            line = session.line(min(left_s, look_s))
            if line == HALT:
                self._halted.set()
                return True
            if line is not None:
                self._reply(session, refusal(Refusal.BUSY))
        return False

    def _reply(self, session: LineSession, answer: Answer) -> None:
        """Send a reply as the faults want it on the wire."""
        reply = answer.line.encode("ascii")
        if not answer.measured:
            session.say_late()
            session.say(reply)
        elif self._faults.take("tracker.eof") is not None:
            raise ConnectionAbortedError
        elif self._faults.take("tracker.no_result") is None:
            session.answer(reply, self._faults)


def serve(site: Site, port: int) -> T2saServer:
    """Return the bridge of a simulated cell, with the points of its file or a fan of its own."""
    options = site.cell.tracker.options
    folder, listed = None, str(options.get("points", ""))
    if listed:
        points = imported(Path(listed))
    else:
        folder = tempfile.TemporaryDirectory(prefix="t2sa-")
        listed = str(Path(folder.name) / "points.csv")
        points = fan(site.cell)
        write(Path(listed), points)
    group = f"{options.get('collection', COLLECTION)};{options.get('group', GROUP)}"
    device = T2saDevice(site.plant.tracker, site.faults, site.time, points, group)
    return T2saServer(
        device,
        site.faults,
        site.time,
        port=port,
        folder=folder,
        points="" if folder is None else listed,
    )
