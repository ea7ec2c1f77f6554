"""The steps before anything moves: which devices there are, and what they can.

Devices are found by their drivers (`hilcell.ports.Discovers`), which listen and read only.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event

import msgspec
import numpy as np

from hilcell import ports
from hilcell.cell.devices import GROUPS, driver_options, installed, load_entry, start_simulation
from hilcell.cell.file import NO_RAIL, Cell, VolumesTable, load_cell
from hilcell.cell.layout import Nest
from hilcell.cell.settings import SettingsError, check_values, convert, read_file
from hilcell.cell.surroundings import LEAST_MM, LINKS
from hilcell.clock import WallClock
from hilcell.commission.cell_text import CellText
from hilcell.commission.dialogue import Dialogue, number, word
from hilcell.commission.draft import write_nests, write_new, write_places, write_robot, write_travel
from hilcell.commission.known_robots import known_robots, stated_robot
from hilcell.commission.record import Check
from hilcell.compensation.targets import read_named_rows
from hilcell.compensation.volumes import HEADER, read_volumes
from hilcell.decoding import Json
from hilcell.errors import HilcellError
from hilcell.identity import Identity

DRAWING_MM = 1e5
REAL, NONE, FLOOR = "real", "none", "floor"
LEAST_NESTS = 3
ELSEWHERE = "other"
ADDRESSES = {"host": "192.168.10.20", "channel": "can0"}  # options, each with an example
Addresses = Mapping[str, Mapping[str, object]]


class WhichDevices:
    """Asks for makes and addresses, finds the devices, and writes the first cell file."""

    def __init__(self, path: Path, text: CellText, dialogue: Dialogue) -> None:
        self._path, self._text, self._dialogue = path, text, dialogue

    def perform(self) -> list[Check]:
        """Return what was found; raises `HilcellError`."""
        write_new(self._text, "name", self._path.stem)
        self._once("serial", "serial or inventory number of this cell", word("a number"), "1")
        addresses = self._simulated()
        found = {
            table: self._device(table, addresses.get(table, {}))
            for table in ("robot", "rail", "tracker")
        }
        self.kinematics(found["robot"].identities)
        self._rail()
        self._nests()
        self._volumes()
        self._text.write(self._path)
        self._controller(load_cell(str(self._path)), addresses)
        return [
            Check(
                what=f"{table} ({self._text.get(f'{table}.driver')})",
                found=device.title,
                expected="a device that answers",
                holds=True,
                values={f"{table}.options.{key}": value for key, value in device.options.items()},
            )
            for table, device in found.items()
            if self._text.get(f"{table}.driver") is not None
        ]

    def _simulated(self) -> Addresses:
        """Return the addresses of a simulated hall; none for real devices."""
        address = self._text.get("simulation.address")
        if address is None:
            known = "real" if any(self._text.get(table) for table in GROUPS) else ""
            address = known or self._dialogue.ask(
                "real devices, or a simulated hall (HOST:PORT, as `hilcell sim` prints)?",
                real_or_hall,
                REAL,
            )
            if address != REAL:
                self._text.set("simulation.simulator", "paper")
                self._text.set("simulation.address", str(address))
        self._dialogue.real = address == REAL
        return {} if self._dialogue.real else addresses_of(str(address))

    def _device(self, table: str, known: Mapping[str, object]) -> ports.Candidate:
        """Choose a driver, find its device, and write what it answers."""
        driver = self._text.get(f"{table}.driver")
        if driver is None:
            group = GROUPS[table]
            makes = {name: summary_of(load_entry(group, name)) for name in installed(group)}
            known_none = table == "rail" and self._text.get("layout.base") is not None
            driver = (
                NO_RAIL if known_none else self._dialogue.choose(f"{table}: which driver?", makes)
            )
            if driver == NO_RAIL:  # a cell file without a rail has no such table
                return ports.Candidate("none", {}, [])
            self._text.set(f"{table}.driver", driver)
        kind = load_entry(GROUPS[table], str(driver))
        stated = self._text.get(f"{table}.options")
        options: Json = {**known, **stated} if isinstance(stated, Mapping) else dict(known)
        found = self.found(table, kind, options)
        for key, value in found.options.items():
            self._text.set(f"{table}.options.{key}", value)
        if table == "tracker":
            self._once(
                "tracker.reflector", "reflector, by its name in the tracker",
                one_of(found.reflectors), "SMR 1.5in",
            )  # fmt: skip
        return found

    def found(self, table: str, kind: type, options: Json) -> ports.Candidate:
        """Return the device that answers, with all its options.

        Without an address the driver lists what it can; a person is asked for one only if that is
        nothing, or if it is something else.
        """
        askable = not options and ADDRESSES.keys() & option_names(kind)
        if not issubclass(kind, ports.Discovers):
            if askable:
                return self._elsewhere(table, kind)
            return ports.Candidate(_words(options) or "none", options, [])
        if options:
            check_values(options, options_of(kind), f"{table}.options")
        candidates = kind.discover(options)
        for each in candidates:
            self._dialogue.say(f"{table}: {each.title}")
        if not candidates and not askable:
            raise HilcellError(
                f"{table}: no device answers at {_words(options) or 'any address'}; check its "
                "power, cable and address",
                code="HC-C40",
            )
        certain = len(candidates) == 1 and (bool(options) or bool(candidates[0].identities))
        names = {str(n): each.title for n, each in enumerate(candidates, start=1)}
        if askable:
            names[ELSEWHERE] = "at an address that you enter"
        taken = "1" if certain else ELSEWHERE
        if candidates and not certain:
            taken = self._dialogue.choose(f"{table}: which one?", names)
        if taken == ELSEWHERE:
            return self._elsewhere(table, kind)
        chosen = candidates[int(taken) - 1]
        if not options and not chosen.identities:  # a line that was listed, not opened
            return self.found(table, kind, chosen.options)
        return replace(chosen, options=options | chosen.options)

    def _elsewhere(self, table: str, kind: type) -> ports.Candidate:
        """Ask for a device's host or channel, whichever its driver has, until one answers there."""
        key = next(each for each in ADDRESSES if each in option_names(kind))

        def at(answer: str) -> ports.Candidate:
            try:
                return self.found(table, kind, {key: word(f"a {key}")(answer)})
            except HilcellError as error:
                raise ValueError(str(error)) from error

        return self._dialogue.ask(f"{table}: {key} (such as {ADDRESSES[key]})?", at)

    def _controller(self, cell: Cell, addresses: Addresses) -> None:
        """Write the tool and the joint limits that the robot's controller states."""
        kind, options = driver_options(cell, "robot", addresses.get("robot", {}))
        robot = kind(options, WallClock(Event()))
        if not isinstance(robot, ports.StatesSettings):
            return
        settings, comment = robot.settings(), "as the controller has it"
        if settings.tool is not None:
            smr_mm = [round(float(value), 3) for value in settings.tool[:3, 3]]
            self._text.set("robot.smr_mm", smr_mm, comment)
        if settings.joint_limits_rad is not None:
            for axis, (low, high) in enumerate(np.degrees(settings.joint_limits_rad)):
                joint = cell.robot.joint[axis]
                if low > joint.min_deg:
                    self._text.set(f"robot.joint.{axis}.min_deg", round(float(low), 3), comment)
                if high < joint.max_deg:
                    self._text.set(f"robot.joint.{axis}.max_deg", round(float(high), 3), comment)
        self._text.write(self._path)
        load_cell(str(self._path))

    def kinematics(self, identities: Sequence[Identity]) -> None:
        """Write the kinematics of the robot that its controller states, else of the one named."""
        if self._text.get("robot.joint") is not None:
            return
        driver = str(self._text.get("robot.driver"))
        known = known_robots(driver)
        if not known:
            raise HilcellError(
                f"robot: no kinematics for {driver}; write [[robot.joint]] into {self._path}",
                code="HC-C40",
            )
        identity = next(iter(identities), Identity())
        robot = stated_robot(known, identity)
        if robot is None:
            names = {name: f"stated as {each.stated[0]}" for name, each in known.items()}
            robot = known[self._dialogue.choose("robot: whose nominal kinematics?", names)]
        else:
            by = " ".join(filter(None, (identity.model, identity.firmware)))
            self._dialogue.say(f"robot: nominal kinematics of {robot.robot.name}, by {by}")
        write_robot(self._text, robot)

    def _rail(self) -> None:
        if self._text.get("rail") is None:
            return
        if self._text.get("rail.travel_min_mm") is None:
            whole_mm = self._dialogue.ask(
                "rail: its whole travel by tape, from end to end, mm",
                number(200.0, DRAWING_MM, "mm"),
            )
            room_mm = self._dialogue.ask(
                "rail: distance by tape from the slide to the nearer end of its travel, mm",
                number(100.0, whole_mm / 2.0, "mm"),
            )
            write_travel(self._text, room_mm)
        if "homing" in option_names(load_entry("rails", str(self._text.get("rail.driver")))):
            self._once(
                "rail.options.homing",
                "rail: homing method of the drive; 35 or 37: the slide stays where it is",
                lambda text: int(number(1, 37, "")(text)),
                "35",
            )
        fastest_mm_s = 1000.0
        self._once(
            "rail.speed_mm_s", "rail: largest speed of the slide, mm/s",
            number(1.0, fastest_mm_s, "mm/s"), "250",
        )  # fmt: skip
        self._once(
            "rail.acceleration_mm_s2", "rail: largest acceleration of the slide, mm/s2",
            number(1.0, 1e4, "mm/s2"), "200",
        )  # fmt: skip

    def _nests(self) -> None:
        if self._text.get("layout.floor") is None:
            nests = self._dialogue.ask(
                "floor nests: a CSV file of the drawing (name,x_mm,y_mm,z_mm in {W}), or "
                f"{NONE}: the tracker finds where they stand",
                drawing,
            )
            if nests:
                self._text.set("layout.floor", nests, "of the drawing")
            else:
                count = self._dialogue.ask("how many floor nests are there?", nest_count, "3")
                write_nests(self._text, count)
        if self._text.get("rail") is None:
            write_places(self._text, 0)
        elif self._text.get("layout.slide") is None:
            count = self._dialogue.ask("how many nests are on the slide?", nest_count, "4")
            write_places(self._text, count)

    def _volumes(self) -> None:
        """Ask where the keep-out volumes come from, and for the arm's shape among them."""
        if self._text.get("keep_out") is None and self._text.get("volumes") is None:
            self._sources_of_volumes()
        volumes = self._text.get("keep_out") or self._text.get("volumes")
        if volumes and self._text.get("robot.envelope") is None:
            self._shape()

    def _sources_of_volumes(self) -> None:
        rail, boxes = self._text.get("rail") is not None, ",".join(HEADER)
        floor = (
            f"{FLOOR} (the floor up to its nests, and the tracker; nothing else is in reach, and "
            "no stand or table under the robot)"
        )
        file = self._dialogue.ask(
            f"keep-out volumes: a CSV file of boxes ({boxes}; on_slide: 1 in nominal {{B}}, 0 in "
            f"{{W}}), {'' if rail else f'{floor}, '}or {NONE}",
            lambda answer: FLOOR if answer == FLOOR and not rail else volume_list(answer),
            NONE,
        )
        if file == FLOOR:
            self._text.set("volumes.floor", True)
            return
        names = self._dialogue.ask(
            f"keep-out volumes whose corners you will teach with a reflector: names, or {NONE}",
            taught_names,
            NONE,
        )
        for key, value in (("file", file), ("teach", names)):
            if value:
                self._text.set(f"volumes.{key}", value)

    def _shape(self) -> None:
        known = known_robots(str(self._text.get("robot.driver"))).get(
            str(self._text.get("robot.name"))
        )
        shape = None if known is None else known.robot.envelope
        radius_mm = self._dialogue.ask(
            "robot: radius of links 1 to 6 about the lines of their joints, with motors, hoses and "
            "tool, mm",
            radii,
            "" if shape is None else " ".join(f"{each:g}" for each in shape.radius_mm),
        )
        self._text.set("robot.envelope.radius_mm", radius_mm, "of links 1 to 6")
        if shape is not None:
            rows = msgspec.to_builtins(shape.capsule)
            self._text.set("robot.envelope.capsule", rows, "nominal parts beside their links")

    def _once(
        self, path: str, question: str, parse: Callable[[str], object], default: str = ""
    ) -> None:
        """Ask for a value unless the file has it."""
        if self._text.get(path) is None:
            self._text.set(path, self._dialogue.ask(question, parse, default))


def one_of(names: Sequence[str]) -> Callable[[str], str]:
    """Return a parser of one of the names, of any where none are known."""

    def parse(answer: str) -> str:
        if names and answer not in names:
            raise ValueError(f"expected one of {', '.join(names)}, got {answer!r}")
        return word("a name")(answer)

    return parse


def real_or_address(answer: str) -> str:
    """Return "real", or the HOST:PORT of a simulated hall; raises `ValueError`."""
    host, _, port = answer.rpartition(":")
    if answer == REAL or (host and port.isdecimal()):
        return answer
    raise ValueError(f"expected {REAL}, or HOST:PORT, got {answer!r}")


def _words(options: Json) -> str:
    return ", ".join(f"{key} {value}" for key, value in options.items())


def real_or_hall(answer: str) -> str:
    """Return "real", or the HOST:PORT at which a hall answers; raises `ValueError`."""
    if real_or_address(answer) != REAL:
        try:
            addresses_of(answer)
        except HilcellError as error:
            raise ValueError(str(error)) from error
    return answer


def options_of(kind: type) -> type[msgspec.Struct]:
    """Return the type of a driver's options."""
    options: type[msgspec.Struct] = kind.Options  # type: ignore[attr-defined]
    return options


def option_names(kind: type) -> set[str]:
    """Return the names of a driver's options."""
    return {*options_of(kind).__struct_fields__}


def volume_list(answer: str) -> str:
    """Return the absolute path of a list of volumes, "" for none; raises `ValueError`."""
    if answer == NONE:
        return ""
    path = Path(answer).resolve()
    try:
        read_volumes(path)
    except SettingsError as error:
        raise ValueError(str(error)) from error
    return str(path)


def taught_names(answer: str) -> list[str]:
    """Return the names of volumes, none for "none"; raises `ValueError`."""
    if answer == NONE:
        return []
    names = [name.strip() for name in answer.split(",")]
    try:
        return convert({"teach": names}, VolumesTable, "names").teach
    except SettingsError as error:
        raise ValueError(str(error)) from error


def radii(answer: str) -> list[float]:
    """Return six radii, mm; raises `ValueError`."""
    parse = number(LEAST_MM, DRAWING_MM, "mm")
    values = [parse(each) for each in answer.split()]
    if len(values) != LINKS:
        raise ValueError(f"expected {LINKS} radii with blanks between, got {len(values)}")
    return values


def nest_count(answer: str) -> int:
    """Return a number of nests; raises `ValueError`."""
    most = 100
    return int(number(LEAST_NESTS, most, "nests")(answer))


def drawing(answer: str) -> list[Json]:
    """Return the nests of a list (docs/lists.md), none for "none"; raises `ValueError`."""
    if answer == NONE:
        return []
    path, header = Path(answer), [*Nest.__struct_fields__]
    try:
        rows = read_named_rows(path, read_file(path), [header], "nests")
    except SettingsError as error:
        raise ValueError(str(error)) from error
    if len(rows.names) < LEAST_NESTS:
        raise ValueError(f"{answer}: expected {LEAST_NESTS} or more nests, got {len(rows.names)}")
    both = zip(rows.names, rows.values, strict=True)
    return [dict(zip(header, [name, *xyz_mm], strict=True)) for name, xyz_mm in both]


@contextmanager
def running(cell: Cell) -> Iterator[ports.SimulatedCell]:
    """Connect to a simulated cell that runs; raises `HilcellError`."""
    simulated = start_simulation(cell, seed=None, speed=1.0)
    assert simulated is not None  # noqa: S101 - the cell is a simulated one
    with closing(simulated):
        yield simulated


def addresses_of(address: str) -> Addresses:
    """Return where the devices of a running simulated hall listen; raises `HilcellError`."""
    with running(load_cell("paper", {"simulation.address": address})) as simulated:
        return simulated.options


def ask_the_person(cell: Cell, device: str) -> None:
    """Ask the person in a running simulated hall to pull a cable; a real one has read it."""
    if cell.simulation is None or not cell.simulation.address:
        return
    with running(cell) as simulated:
        if isinstance(simulated, ports.HasPerson):
            simulated.pull_cable(device)


def carry_reflector(cell: Cell, near_mm: Sequence[float]) -> None:
    """Let the person in a running simulated cell seat the only reflector in the nest nearest to
    (3,), tracker's frame; a real one has read it.
    """
    if not cell.layout.by_hand or cell.simulation is None or not cell.simulation.address:
        return
    with running(cell) as simulated:
        if isinstance(simulated, ports.HasPerson):
            simulated.carry_reflector(near_mm)


def what_devices_can(cell: Cell) -> list[ports.Ability]:
    """Return the abilities of all devices; nothing is changed, powered or moved."""
    simulated = {} if cell.simulation is None else addresses_of(cell.simulation.address)
    found: list[ports.Ability] = []
    for table in GROUPS:
        kind, options = driver_options(cell, table, simulated.get(table, {}))
        device = kind(options, WallClock(Event()))
        found += device.inspect() if isinstance(device, ports.Inspects) else []
    return found


def summary_of(kind: type) -> str:
    """Return the first line of the driver's module."""
    text = sys.modules[kind.__module__].__doc__ or kind.__doc__ or ""
    return text.strip().partition("\n")[0].rstrip(".")
