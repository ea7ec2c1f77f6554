"""Devices of a cell: drivers from entry points, built from the cell file's tables; addresses."""

from __future__ import annotations

import inspect
import ipaddress
import json
import socket
import sys
import threading
from collections.abc import Callable, Container, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path
from typing import Any, NamedTuple, Self
from urllib.parse import urlsplit

import msgspec

from hilcell import ports
from hilcell.alarms.catalogue import CatalogueError, catalogue
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError, convert, did_you_mean
from hilcell.cell.source import built_in_cells
from hilcell.decoding import learn
from hilcell.errors import EXIT_REFUSED, HilcellError, one_line, with_location


def port_mismatches(kind: type, port: type) -> list[str]:
    """Return why a driver's class does not satisfy a port."""
    options = getattr(kind, "Options", None)
    typed = isinstance(options, type) and issubclass(options, msgspec.Struct)
    methods = [name for name in vars(port) if not name.startswith("_")]
    lacking = [name for name in methods if not callable(getattr(kind, name, None))]
    if missing := ([] if typed else ["Options (a msgspec.Struct)"]) + lacking:
        return [f"it has no {', '.join(missing)}"]
    mismatches = [_call_mismatch("__init__", kind, ("options", "clock"))]
    for name in methods:
        parameters = inspect.signature(getattr(port, name)).parameters
        mismatches.append(_call_mismatch(name, getattr(kind, name), parameters))
    try:
        learn(options)
    except Exception as error:  # noqa: BLE001 - an annotation is any expression
        mismatches.insert(0, f"its Options have a type that cannot be used: {one_line(error)}")
    return [each for each in mismatches if each]


def _call_mismatch(name: str, call: Callable[..., object], parameters: Iterable[str]) -> str:
    """Return why a method does not accept these arguments, or ""."""
    try:
        signature = inspect.signature(call)
    except (TypeError, ValueError):  # not written in Python
        return ""
    try:
        signature.bind(*parameters)
    except TypeError as error:
        expected = ", ".join(each for each in parameters if each != "self")
        return f"its {name} does not accept ({expected}): {error}"
    return ""


GROUPS = {"rail": "rails", "robot": "robots", "tracker": "trackers"}  # of entry points, by table
PORTS: Mapping[str, type] = {"rails": ports.Rail, "robots": ports.Robot, "trackers": ports.Tracker}


def load_entry(group: str, name: str) -> Any:
    """Return the entry point ``name`` of ``hilcell.<group>``, loaded; raises `SettingsError`."""
    entries = _entries(group)
    found = {entry.value: entry for entry in entries if entry.name == name}
    if not found:
        known = ", ".join(sorted(entries.names)) or "none; is the package installed?"
        hint = did_you_mean(name, entries.names) or f"; installed: {known}"
        raise SettingsError(group, [f"{name!r} is not installed{hint}"])
    if len(found) > 1:
        both = " and ".join(sorted(found))
        raise SettingsError(group, [f"{name!r} is installed as {both}; uninstall all but one"])
    try:
        loaded = found.popitem()[1].load()
    except Exception as error:
        why = error if isinstance(error, ImportError | AttributeError) else one_line(error)
        raise SettingsError(group, [f"{name!r} cannot be loaded: {why}"]) from error
    if group in PORTS and (mismatches := port_mismatches(loaded, PORTS[group])):
        what = f"{name!r} is not a driver: {'; '.join(mismatches)}"
        raise SettingsError(group, [f"{what}; see hilcell.ports.{PORTS[group].__name__}"])
    return loaded


def installed(group: str) -> list[str]:
    """Return the names of the entry points of ``hilcell.<group>``."""
    return sorted(_entries(group).names)


def _entries(group: str) -> EntryPoints:
    return _installed(tuple(sys.path)).get(f"hilcell.{group}", EntryPoints())


@cache
def _installed(path: tuple[str, ...]) -> Mapping[str, EntryPoints]:
    """Return hilcell's entry points by group; cached, for it reads the metadata of all packages."""
    every = entry_points()
    groups = [group for group in every.groups if group.startswith("hilcell.")]
    return {group: every.select(group=group) for group in groups}


@dataclass(frozen=True, slots=True)
class Devices:
    """The three devices of a cell."""

    rail: ports.Rail
    robot: ports.Robot
    tracker: ports.Tracker
    rail_on_robot: bool = False  # the rail is an external axis of the robot

    def named(self) -> dict[str, ports.Rail | ports.Robot | ports.Tracker]:
        """Return the devices by name, in the order of connection."""
        if self.rail_on_robot:
            return {"Robot": self.robot, "Rail": self.rail, "Tracker": self.tracker}
        return {"Rail": self.rail, "Robot": self.robot, "Tracker": self.tracker}


def streaming_tracker(tracker: ports.Tracker) -> ports.Streams:
    """Return the tracker if it streams; raises `DeviceRefused`."""
    if isinstance(tracker, ports.Streams):
        return tracker
    raise _unable("HC-T43", "Tracker", "stream", "stream", "at rest")


def two_face_tracker(tracker: ports.Tracker) -> ports.TwoFaces:
    """Return the tracker if it measures in two faces; raises `DeviceRefused`."""
    if isinstance(tracker, ports.TwoFaces):
        return tracker
    raise _unable("HC-T43", "Tracker", "change face", "measure_back", "in one face")


def aiming_tracker(tracker: ports.Tracker) -> ports.Aims:
    """Return the tracker if a person can aim it; raises `DeviceRefused`."""
    if isinstance(tracker, ports.Aims):
        return tracker
    raise _unable("HC-T43", "Tracker", "aim", "measure_aimed", "at the places of the cell file")


def searching_tracker(tracker: ports.Tracker) -> ports.Searches:
    """Return the tracker if it searches more widely; raises `DeviceRefused`."""
    if isinstance(tracker, ports.Searches):
        return tracker
    raise _unable("HC-T43", "Tracker", "search", "search", "at the places of the cell file")


def jogging_rail(rail: ports.Rail) -> ports.Jogs:
    """Return the rail if it jogs; raises `DeviceRefused`."""
    if isinstance(rail, ports.Jogs):
        return rail
    raise _unable("HC-R48", "Rail", "jog", "jog", "with a proved scale")


def self_stopping_rail(rail: ports.Rail) -> ports.StopsItself:
    """Return the rail if its self-stop can be tried; raises `DeviceRefused`."""
    if isinstance(rail, ports.StopsItself):
        return rail
    raise _no_self_stop()


def self_stop_s(driver: str) -> float:
    """Return the longest time from the PC's last sign until a rail brakes by itself; raises
    `DeviceRefused` where its driver cannot try it.
    """
    stated = getattr(load_entry(GROUPS["rail"], driver), "own_stop_s", None)
    if not isinstance(stated, float):
        raise _no_self_stop()
    return stated


def _no_self_stop() -> ports.DeviceRefused:
    return ports.DeviceRefused(
        "HC-R55",
        "Rail",
        "self-stop",
        "no `jog_until_lost`",
        expected="a driver with `jog_until_lost`",
        act='verify it by hand, as docs/hardware.md describes, and answer "not now" here',
    )


def sweeping_robot(robot: ports.Robot) -> ports.Sweeps:
    """Return the robot if it sweeps an axis; raises `DeviceRefused`."""
    if isinstance(robot, ports.Sweeps):
        return robot
    raise _unable("HC-B42", "Robot", "sweep", "sweep", "at rest")


def _unable(code: str, device: str, doing: str, method: str, instead: str) -> ports.DeviceRefused:
    wanted, act = f"a driver with `{method}`", f"choose a procedure that measures {instead} only"
    return ports.DeviceRefused(code, device, doing, f"no `{method}`", expected=wanted, act=act)


def least_separation_rad(cell: Cell) -> float:
    """Return the least angle between reflectors that the tracker separates; 0 if unknown."""
    return float(getattr(load_entry("trackers", cell.tracker.driver), "SIGHTS_APART_RAD", 0.0))


def tracker_accuracy(cell: Cell) -> ports.StatesAccuracy | None:
    """Return the tracker's accuracy class, None if its driver has none."""
    anywhere = {} if cell.simulation is None else placeholder_addresses(cell).get("tracker", {})
    try:
        _, options = driver_options(cell, "tracker", anywhere)
    except SettingsError:
        return None  # reported where the options are checked
    return options if isinstance(options, ports.StatesAccuracy) else None


def abilities(cell: Cell) -> dict[str, bool]:
    tracker = load_entry("trackers", cell.tracker.driver)
    return {
        "tracker_streams": issubclass(tracker, ports.Streams),
        "tracker_turns_over": issubclass(tracker, ports.TwoFaces),
        "tracker_searches": issubclass(tracker, ports.Searches),
        "tracker_aims": issubclass(tracker, ports.Aims),
        "robot_sweeps": issubclass(load_entry("robots", cell.robot.driver), ports.Sweeps),
    }


class Rests(NamedTuple):
    """Planned rests of robot and slide before a measurement, in s."""

    robot_s: float
    rail_s: float

    @classmethod
    def of(cls, cell: Cell) -> Self:
        """Return the least on a quick plan where the tracker shows the rest of a motion. That of
        the slide is seen in the nest that verifies its hold.
        """
        settle = cell.settle
        shown = cell.plan.quick and abilities(cell)["tracker_streams"]
        if not shown:
            return cls(settle.robot_s, settle.rail_s)
        robot_s = min(settle.robot_s, settle.robot_least_s)
        if cell.layout.by_hand:  # the nest is empty
            return cls(robot_s, settle.rail_s)
        return cls(robot_s, min(settle.rail_s, settle.rail_least_s))


def is_robot_driven(cell: Cell) -> bool:
    return issubclass(load_entry("rails", cell.rail.driver), ports.RobotDrivenRail)


def build_devices(
    cell: Cell, addresses: Mapping[str, Mapping[str, object]], clock: ports.Clock
) -> Devices:
    """Build the drivers, unopened, ``addresses`` before their options; raises `SettingsError`."""
    built: dict[str, Any] = {}
    for table in GROUPS:
        kind, options = driver_options(cell, table, addresses.get(table, {}))
        try:
            built[table] = kind(options, clock)
        except HilcellError:
            raise
        except Exception as error:
            name = getattr(cell, table).driver
            problem = f"{table}.driver: {name!r} cannot be built: {with_location(error)}"
            raise SettingsError(cell.name, [problem]) from error
    rides = isinstance(built["rail"], ports.RobotDrivenRail)
    if rides:
        built["rail"].attach_robot(built["robot"])
    return Devices(**built, rail_on_robot=rides)


def driver_options(
    cell: Cell, table: str, addresses: Mapping[str, object]
) -> tuple[Callable[..., Any], msgspec.Struct]:
    """Return a driver class and its checked options.

    Options with the names of the table's keys (travel, speed, tool point, reflector) get the
    table's values. Raises `SettingsError`, also if the options repeat such a key.
    """
    shared = getattr(cell, table)
    kind = load_entry(GROUPS[table], shared.driver)
    wanted = set(kind.Options.__struct_fields__)
    stated = msgspec.to_builtins(shared)
    problems = [
        f"{key}: {value!r} here, but {table}.{key} is {stated[key]!r}; set it in [{table}] only"
        for key, value in shared.options.items()
        if key in stated
    ]
    if foreign := ", ".join(key for key in addresses if key not in wanted):
        found = f"the simulated {table} has the options {foreign}, driver {shared.driver!r} has not"
        act = "use a simulator of its protocol, or delete [simulation]"
        raise SettingsError(table, [f"{found}; {act}"])
    own = {key: value for key, value in shared.options.items() if key not in stated}
    values = {name: value for name, value in stated.items() if name in wanted}
    try:
        options = convert(values | own | dict(addresses), kind.Options, table)
    except SettingsError as error:
        raise SettingsError(table, problems + error.problems) from None
    if problems:
        raise SettingsError(table, problems)
    return kind, options


def checked_options(
    cell: Cell, addresses: Mapping[str, Mapping[str, object]], tables: Container[str] = GROUPS
) -> dict[str, dict[str, object]]:
    """Return the checked options of drivers as plain values; raises `SettingsError`."""
    return {
        table: msgspec.to_builtins(driver_options(cell, table, addresses.get(table, {}))[1])
        for table in GROUPS
        if table in tables
    }


def device_addresses(
    cell: Cell, addresses: Mapping[str, Mapping[str, object]]
) -> dict[str, list[str]]:
    """Return the addresses of the cell's devices, normalised, each with its tables."""
    tables: dict[str, list[str]] = {}
    for table, options in checked_options(cell, addresses).items():
        for place in places(options):
            tables.setdefault(place, []).append(table)
    return tables


def unknown_drivers(drivers: Mapping[str, str]) -> list[str]:
    problems: list[str] = []
    for table, group in GROUPS.items():
        try:
            load_entry(group, drivers.get(table, ""))
        except SettingsError as error:
            problems += [f"{table}.driver: {line}" for line in error.problems if table in drivers]
    return problems


def check_options(cell: Cell) -> None:
    """Check options, addresses, simulator, catalogues; raises `SettingsError` with all problems."""
    problems: list[str] = []
    unknown = False
    anywhere = {} if cell.simulation is None else placeholder_addresses(cell)
    for table, group in GROUPS.items():
        try:
            driver_options(cell, table, anywhere.get(table, {}))
        except SettingsError as error:
            key = "driver" if error.source == group else "options"
            unknown = unknown or key == "driver"
            problems += [f"{table}.{key}: {line}" for line in error.problems]
    if cell.simulation is not None:
        try:
            simulator = load_entry("simulators", cell.simulation.simulator)
            if not unknown:  # it would report the same
                simulator.check(cell)
        except SettingsError as error:
            key = "simulation.simulator" if error.source == "simulators" else error.source
            problems += [f"{key}: {line}" for line in error.problems]
    if not problems:
        robot = load_entry("robots", cell.robot.driver)
        if is_robot_driven(cell) and not issubclass(robot, ports.ExternalAxis):
            problems.append(
                f"rail.driver: {cell.rail.driver!r} is an external axis of the robot, but robot "
                f"driver {cell.robot.driver!r} moves none; change one of them"
            )
        problems += [
            f"{' and '.join(tables)} have the same address {place}"
            for place, tables in device_addresses(cell, anywhere).items()
            if len(tables) > 1
        ]
    try:
        catalogue()
    except CatalogueError as error:
        problems.append(str(error))
    if problems:
        raise SettingsError(cell.name, problems)


def placeholder_addresses(cell: Cell) -> dict[str, dict[str, object]]:
    """Return an address for each device without one: a simulated cell replaces it."""
    addresses: dict[str, dict[str, object]] = {}
    for n, (table, group) in enumerate(GROUPS.items(), start=1):
        shared = getattr(cell, table)
        try:
            options = load_entry(group, shared.driver).Options
        except SettingsError:
            continue  # reported where its options are checked
        own_places = {"host": "127.0.0.1", "channel": f"socket://127.0.0.1:{n}"}
        wanted = {each.name for each in msgspec.structs.fields(options) if each.required}
        unstated = set(options.__struct_fields__).difference(shared.options)
        addresses[table] = {key: place for key, place in own_places.items() if key in unstated}
        strip = shared.options.get("strip", {} if "strip" in wanted else None)
        if isinstance(strip, Mapping):
            other = f"socket://127.0.0.1:{n + len(GROUPS)}"  # not the drive's
            addresses[table]["strip"] = {"driver": "serial", "channel": other} | dict(strip)
    return addresses


def load_measured(where: str, overrides: Mapping[str, str]) -> Cell:
    """Read a cell as `load_cell`; refuse a hall of which no file has the places.

    Raises `SettingsError`.
    """
    cell = load_cell(where, overrides)
    running = cell.simulation is not None and cell.simulation.address
    if draws_hall(cell) and (where in built_in_cells() or not running):
        problem = "simulation.simulator: it draws a hall, and no cell file has the places of that"
        act = "start it by `hilcell sim --cell unknown`, measure it by `hilcell commission "
        raise SettingsError(where, [f"{problem}; {act}mycell.toml`, then use mycell.toml"])
    return cell


def draws_hall(cell: Cell) -> bool:
    """Whether the cell's simulator, if installed, draws a hall of which only a sheet is known."""
    name = "" if cell.simulation is None else cell.simulation.simulator
    known = name in installed("simulators")
    return known and isinstance(load_entry("simulators", name), ports.HasSheet)


def is_replay(cell: Cell) -> bool:
    return cell.simulation is not None and issubclass(
        load_entry("simulators", cell.simulation.simulator), ports.RepeatsRun
    )


def check_replay(cell: Cell, procedure: str, seed: int) -> None:
    """Refuse a procedure or seed that a replayed run does not have; raises `SettingsError`."""
    if cell.simulation is not None and is_replay(cell):
        load_entry("simulators", cell.simulation.simulator).check_run(cell, procedure, seed)


def start_simulation(
    cell: Cell,
    *,
    seed: int | None,
    speed: float,
    session: int = 1,
    run_seed: int | None = None,
    **more: object,
) -> ports.SimulatedCell | None:
    """Start the simulated cell of the cell file, if any.

    ``seed`` is its machine's, None for a running one; ``run_seed``: of the run, for its noise. Each
    ``session`` has noise of its own: a resumed run must not read the same again. ``more`` (faults,
    ports, truth) is for `hilcell sim`.
    """
    if cell.simulation is None:
        return None
    sessions = 2**32  # beyond all seeds of runs
    noise_seed = None if run_seed is None else run_seed + (session - 1) * sessions
    more |= {"session": session} if is_replay(cell) else {"run_seed": noise_seed}
    simulator = load_entry("simulators", cell.simulation.simulator)
    simulated: ports.SimulatedCell = simulator(cell, seed=seed, speed=speed, **more)
    return simulated


def in_process_cell(cell: Cell, seed: int, run_seed: int | None = None) -> ports.InProcessCell:
    """Return the simulated cell without wires; raises `SettingsError`."""
    if cell.simulation is None:
        raise SettingsError("simulation", ["missing; a cell without it has real devices only"])
    found: ports.InProcessCell = load_entry("in_process_cells", cell.simulation.simulator)(
        cell, seed, run_seed
    )
    return found


class ConnectFailed(ports.DeviceError):
    """Some devices could not be connected; the message lists all of them as a tree."""

    def __init__(self, failures: Mapping[str, ports.DeviceError]) -> None:
        found = f"{', '.join(failures)} failed"
        super().__init__("HC-C15", "Cell", "connect", found, causes=failures)
        if all(isinstance(each, ports.DeviceRefused) for each in failures.values()):
            self.exit_code = EXIT_REFUSED


def connect_all(
    devices: Devices, claim: Callable[[list[ports.Identity]], None]
) -> list[ports.Identity]:
    """Connect all devices and return the identities; raises `ConnectFailed` with all failures.

    ``claim`` receives the identities of each device before the next is connected, and may raise.
    """
    identities: list[ports.Identity] = []
    failures: dict[str, ports.DeviceError] = {}
    for name, device in devices.named().items():
        try:
            found = device.connect()
        except ports.DeviceError as error:
            failures[name] = error
        else:
            claim(found)
            identities += found
    if failures:
        raise ConnectFailed(failures)
    return identities


# -- normalised addresses: two spellings of one address must give one lock -------------------------
#
# A host is compared by its IP addresses, a device file by the target of its links. A name server
# may be slow; a name not resolved within `RESOLVE_S` is compared as text.


RESOLVE_S = 1.0
THIS_MACHINE = "this machine"


def places(options: Mapping[str, object]) -> list[str]:
    """Return the normalised addresses in a driver's options, and in tables of its parts.

    ``host`` with ``port``, or with named ports such as ``rtde_port``; or ``channel``: the URL of a
    network gateway, a serial port with or without baud rate, a CAN interface. Options without
    either are one address as a whole.
    """
    parts = [part for part in options.values() if isinstance(part, Mapping)]
    of_parts = [
        place for part in parts if part.keys() & {"host", "channel"} for place in places(part)
    ]
    host, port, channel = (options.get(key) for key in ("host", "port", "channel"))
    if host is not None:
        named = [each for key, each in options.items() if key.endswith("_port")]
        ports = named if port is None and named else [port]
        return [place for each in ports for place in _network(str(host), each)] + of_parts
    if channel is not None:
        return _channel(str(channel)) + of_parts
    return of_parts or [json.dumps(dict(options), sort_keys=True, default=str)]


def _channel(channel: str) -> list[str]:
    if "://" in channel:
        try:
            url = urlsplit(channel)
            return _network(url.hostname or "", url.port)
        except ValueError:  # impossible port: the driver refuses it
            return [channel]
    port = channel.partition("@")[0]  # of a serial port, as python-can writes its baud rate
    if port.startswith("/"):
        return [str(Path(port).resolve())]
    return [port.upper() if port.upper().startswith("COM") else port]


def _network(host: str, port: object) -> list[str]:
    """Return the addresses of a host; all of this machine's own are one."""
    found = _resolved(host.rstrip(".")) if _number(host) is None else {host}
    return sorted({f"{THIS_MACHINE if _is_ours(each) else each}:{port}" for each in found})


def _number(address: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    with suppress(ValueError):
        return ipaddress.ip_address(address)
    return None


def _resolved(host: str) -> set[str]:
    found: set[str] = set()

    def ask() -> None:
        try:
            answers = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
        except OSError:  # the driver reports it when it connects
            return
        found.update(str(answer[4][0]) for answer in answers)

    asking = threading.Thread(target=ask, name="resolve", daemon=True)
    asking.start()
    asking.join(RESOLVE_S)
    return set(found) or {host.casefold()}


def _is_ours(address: str) -> bool:
    """Whether an address is one of this machine's: a socket can be bound to it."""
    number = _number(address)
    if number is None:
        return False
    if isinstance(number, ipaddress.IPv6Address) and number.ipv4_mapped is not None:
        number = number.ipv4_mapped
    if number.is_loopback or number.is_unspecified:
        return True
    family = socket.AF_INET if number.version == 4 else socket.AF_INET6
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind((str(number), 0))
    except OSError:
        return False
    return True
