"""``doctor``: check this PC, and optionally the addresses of a cell's devices; nothing moves.

Each check returns a finding, with the remedy if one is needed. The only change is a temporary file
in the folder of runs.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import shutil
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import Distribution, requires
from pathlib import Path
from typing import Literal, NamedTuple

from hilcell.alarms.catalogue import CatalogueError, catalogue
from hilcell.atomic_files import NotWritten
from hilcell.cell.devices import (
    PORTS,
    THIS_MACHINE,
    check_options,
    device_addresses,
    driver_options,
    installed,
    load_entry,
    load_measured,
)
from hilcell.cell.differences import controller_differences
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.clock import WallClock
from hilcell.commands.console import print_data, print_json
from hilcell.commands.signatures import Doctor
from hilcell.commission.first_steps import Addresses, running
from hilcell.errors import EXIT_REFUSED, HilcellError
from hilcell.journal.disk_space import bytes_free, bytes_needed, nearest_existing
from hilcell.journal.journal import StorageError
from hilcell.ports import DeviceError, Inspects, StatesSettings
from hilcell.report.pdf import find_browser
from hilcell.run.cell_lock import CellLocked, lock_of_device, locked, locks_folder
from hilcell.sanitize import harmless_lines
from hilcell.tui.keys import default_file, load_keys
from hilcell.tui.terminal import has_colours, has_unicode, is_coerced

PARTS = (*PORTS, *(f"simulated_{group}" for group in PORTS), "programs", "program_writers")
CONNECTED = "accepts connections"
SHOWN = {"ok": "ok", "warning": "note", "wrong": "WRONG"}


class Finding(NamedTuple):
    """The result of a check, as text, and what to ``do`` if something is needed."""

    state: Literal["ok", "warning", "wrong"]
    found: str
    do: str = ""


def doctor(args: Doctor) -> int:
    """Print all checks; exit code 2 if something prevents a run."""
    found = {
        "python": python(),
        "terminal": terminal(os.environ, *shutil.get_terminal_size()),
        "CAN": can(),
        "serial ports": serial_ports(),
        "ports": loopback(),
        "disk": disk(args.runs),
        "clock": clock(args.runs),
        "locks": locks(),
        "pace": pace(),
        "browser": browser(),
        "keys": _keys(),
        "drivers": _drivers(),
    }
    if args.cell:
        found |= _devices(args.cell, dict(args.settings))
    ok = all(each.state != "wrong" for each in found.values())
    if args.json:
        checks = [{"check": check} | each._asdict() for check, each in found.items()]
        print_json({"ok": ok, "checks": checks})
    else:
        lines = list[str]()
        for check, each in found.items():
            lines.append(f"{SHOWN[each.state]:6} {check:13} {each.found}")
            lines += [f"{'':20} -> {each.do}"] if each.do else []
        print_data(harmless_lines("\n".join(lines)))
    return 0 if ok else EXIT_REFUSED


# -- this PC --------------------------------------------------------------------------------------

LEAST_PYTHON = (3, 11)
PLENTY_GB = 1.0  # a hundred runs of up to 10 MB
WAKES, LATE_S = 200, 0.05  # a stop takes 0.02 s
DIALOUT = "sudo usermod -a -G dialout $USER, then log in again"


def python() -> Finding:
    """Check the interpreter and the required packages."""
    found = f"{platform.python_version()} at {sys.executable}"
    if sys.version_info < LEAST_PYTHON:
        return Finding("wrong", found, "install Python 3.11 or newer")
    lines = [line for line in requires("hilcell") or [] if "extra ==" not in line]
    names = [name[0] for line in lines if (name := re.match(r"[\w.-]+", line))]
    missing = [name for name in names if not any(Distribution.discover(name=name))]
    if missing:
        return Finding("wrong", f"{found} lacks {', '.join(missing)}", "reinstall hilcell")
    return Finding("ok", found)


def terminal(environment: Mapping[str, str], columns: int, rows: int) -> Finding:
    """Check that the terminal can show the screen."""
    shapes = "UTF-8" if has_unicode(environment, coerced=is_coerced()) else "ASCII shapes"
    colours = "colours" if has_colours(environment) else "no colours"
    found = f"TERM {environment.get('TERM') or 'not set'}, {columns} x {rows}, {shapes}, {colours}"
    if columns < 60 or rows < 15:  # 80 x 24 shows everything
        return Finding("warning", found, "enlarge the window to 80 x 24 before `hilcell tui`")
    if shapes != "UTF-8":
        return Finding("warning", found, "set LANG=C.UTF-8 and TERM=xterm-256color for all shapes")
    return Finding("ok", found)


def can(interfaces: Path = Path("/sys/class/net")) -> Finding:
    """Check the CAN interfaces, which only SocketCAN needs."""

    def read(path: Path) -> str:
        with suppress(OSError):
            return path.read_text("ascii").strip()
        return ""

    found = {
        each.name: read(each / "operstate")
        for each in sorted(interfaces.glob("*"))
        if read(each / "type") == "280"  # ARPHRD_CAN of linux/if_arp.h
    }
    if not found:
        return Finding(
            "ok", "no interface (needed for a rail on SocketCAN, not for an slcan gateway)"
        )
    down = [name for name, state in found.items() if state not in {"up", "unknown"}]
    words = ", ".join(f"{name} {state}" for name, state in found.items())
    if down:
        return Finding("warning", words, f"sudo ip link set {down[0]} up type can bitrate 500000")
    return Finding("ok", words)


def serial_ports(devices: Path = Path("/dev")) -> Finding:
    """Check the permissions of serial adapters."""
    ports = sorted(str(port) for kind in ("USB", "ACM") for port in devices.glob(f"tty{kind}*"))
    closed = [port for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    if closed:
        return Finding("warning", f"{', '.join(closed)}: no permission to open", DIALOUT)
    return Finding("ok", ", ".join(ports) or "none")


def loopback() -> Finding:
    """Check connections between programs on this PC, such as the screen and the run."""
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            port = server.getsockname()[1]
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
    except OSError as error:
        found = f"127.0.0.1 cannot be used: {error.strerror or error}"
        advice = "allow connections to 127.0.0.1 (sudo ip link set lo up; the firewall)"
        return Finding("wrong", found, advice)
    return Finding("ok", "127.0.0.1 can be used")


def disk(runs: Path, mounts: Path = Path("/proc/self/mounts")) -> Finding:
    """Check the folder of runs: write permission, free space, and a local disk."""
    folder, where = nearest_existing(runs), str(runs.absolute())
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"\0")
            os.fsync(file.fileno())
        free = bytes_free(folder)
    except OSError as error:
        found = f"{where} cannot be written: {error.strerror}"
        return Finding("wrong", found, "choose another folder with --runs")
    found = f"{where}, {free / 1e9:.2f} GB free"
    longest_points = 1_700  # of all runs of the built-in cells
    if free < (needed := bytes_needed(longest_points)):
        return Finding("wrong", found, f"free {needed / 1e6:.0f} MB, which a run needs")
    shared = {"nfs", "nfs4", "cifs", "smb3", "smbfs", "fuse.sshfs", "9p"}  # no locks for SQLite
    if (kind := _file_system(folder, mounts)) in shared:
        found += f", on a network file system ({kind})"
        advice = "choose a folder on a local disk with --runs: journals need its locks"
        return Finding("wrong", found, advice)
    if free < PLENTY_GB * 1e9:
        return Finding("warning", found, f"free {PLENTY_GB:g} GB for later runs")
    return Finding("ok", found)


def _file_system(folder: Path, mounts: Path) -> str:
    """Return the type of the file system of ``folder``, or ""."""
    text = mounts.read_text("utf-8", "replace") if mounts.exists() else ""
    # The last mount counts; spaces in names are octal escapes (proc(5)).
    points = {
        re.sub(r"\\([0-7]{3})", lambda found: chr(int(found[1], 8)), fields[1]): fields[2]
        for fields in map(str.split, text.splitlines()) if len(fields) > 2
    }  # fmt: skip
    resolved = folder.resolve()
    return next((points[at] for at in map(str, (resolved, *resolved.parents)) if at in points), "")


def clock(runs: Path) -> Finding:
    """Check the clock, which determines the age of calibrations."""
    now_s = time.time()
    found = time.strftime("%Y-%m-%d %H:%M:%S %Z", time.localtime(now_s))
    newest_s = max((each.stat().st_mtime for each in runs.glob("*")), default=0.0)
    if newest_s > now_s + 60.0:
        return Finding("wrong", f"{found}, earlier than the newest run", "set the clock")
    # The kernel's answer is from adjtimex(2) with modes 0, which sets nothing.
    timex = ctypes.create_string_buffer(512)  # larger than struct timex
    unsynchronized = 5  # TIME_ERROR
    if int(ctypes.CDLL(None).adjtimex(timex)) in {-1, unsynchronized}:
        return Finding(
            "warning",
            f"{found}, not synchronized",
            "sudo timedatectl set-ntp true, or set it by hand: calibrations expire by this clock",
        )
    return Finding("ok", f"{found}, synchronized")


def locks() -> Finding:
    try:
        folder, warning = locks_folder()
    except StorageError as error:
        found, _, do = str(error).rpartition("; ")
        return Finding("wrong", found or do, do if found else "correct its permissions")
    if warning:
        found, _, do = warning.rpartition(": ")
        return Finding("warning", found, do)
    return Finding("ok", str(folder))


def pace() -> Finding:
    """Check how late this PC wakes a waiting program."""
    wait_s, late_s = 0.005, list[float]()
    for _ in range(WAKES):
        due_s = time.monotonic() + wait_s
        time.sleep(wait_s)
        late_s.append(time.monotonic() - due_s)
    worst_s = max(late_s)
    found = f"wakes at most {1e3 * worst_s:.1f} ms late ({WAKES} waits)"
    if not worst_s <= LATE_S:
        return Finding("warning", found, "close other programs: a busy PC stops late")
    return Finding("ok", found)


def browser() -> Finding:
    """Check for a browser, needed for PDF reports only."""
    try:
        return Finding("ok", f"{find_browser()} prints reports as PDF")
    except NotWritten:
        advice = "install chromium for `hilcell report -o FILE.pdf`"
        return Finding("warning", "none; reports are HTML only", advice)


def _keys() -> Finding:
    try:
        load_keys(None)
    except SettingsError as error:
        return Finding("wrong", str(error), f"correct {default_file()}")
    file = default_file()
    return Finding("ok", str(file) if file.exists() else "default bindings")


def _drivers() -> Finding:
    problems = list[str]()
    for group in PARTS:
        for name in installed(group):
            try:
                load_entry(group, name)
            except SettingsError as error:
                problems += [f"{group}: {line}" for line in error.problems]
    try:
        catalogue()
    except CatalogueError as error:
        problems.append(str(error))
    if problems:
        return Finding("warning", "; ".join(problems), "repair or uninstall the package")
    found = "; ".join(f"{group} {', '.join(installed(group))}" for group in (*PORTS, "programs"))
    return Finding("ok", found)


# -- the addresses of a cell's devices ------------------------------------------------------------


def _devices(where: str, overrides: dict[str, str]) -> dict[str, Finding]:
    """Check the addresses of a cell's devices; raises `SettingsError`."""
    cell = load_measured(where, overrides)
    check_options(cell)
    addresses: Addresses = {}
    if cell.simulation is not None:
        if not cell.simulation.address:
            return {"cell": Finding("ok", f"{cell.name}: simulated; a run starts its devices")}
        try:
            with running(cell) as simulated:
                addresses = simulated.options
        except HilcellError as error:
            return {"cell": Finding("wrong", str(error), "start `hilcell sim`")}
    checked: dict[str, Finding] = {}
    for place, tables in device_addresses(cell, addresses).items():
        if tables == ["rail"] and not cell.has_rail:
            continue
        check = f"{' and '.join(tables)} at {place}"
        try:  # a connection could disturb a run that uses the device
            with locked(lock_of_device(place), check, "hilcell doctor"):
                checked[check] = _place(place)
                if "robot" in tables and checked[check].found == CONNECTED:
                    checked["robot's settings"] = robot_settings(cell, addresses)
        except CellLocked as error:
            checked[check] = Finding("ok", f"in use: {error}")
    return checked


def robot_settings(cell: Cell, addresses: Addresses) -> Finding:
    """Compare the robot's controller with the cell file and with what its driver needs; reads only.

    Its tool and limits, and its abilities that are mandatory.
    """
    kind, options = driver_options(cell, "robot", addresses.get("robot", {}))
    robot, found = kind(options, WallClock(threading.Event())), list[str]()
    if not isinstance(robot, StatesSettings | Inspects):
        return Finding("ok", "not compared: the driver does not read them")
    try:
        if isinstance(robot, Inspects):
            needs = (each for each in robot.inspect() if each.needed == "mandatory")
            found += [f"{each.feature}: {each.note}" for each in needs if each.state == "has not"]
        if isinstance(robot, StatesSettings):
            found += controller_differences(cell, robot.settings())
    except DeviceError as error:
        return Finding("wrong", str(error))
    if found:
        return Finding("wrong", "; ".join(found), "correct the controller, or the cell file")
    return Finding("ok", "tool and limits allow what the cell file needs")


def _place(place: str) -> Finding:
    if place.startswith("{"):  # all options of a driver without host, port or channel
        return Finding("ok", "not checked: its driver has no option host, port or channel")
    host, sign, port = place.rpartition(":")
    if sign and port.isdecimal():
        address = "127.0.0.1" if host == THIS_MACHINE else host, int(port)
        try:
            socket.create_connection(address, timeout=2.0).close()
        except OSError as error:
            found = f"no connection: {error.strerror or error}"
            return Finding(
                "wrong", found, "switch the device on; check its cable, address and port"
            )
        return Finding("ok", CONNECTED)
    if place.startswith("/"):
        if not Path(place).exists():
            return Finding("wrong", "no such port", "plug in the adapter, or correct the channel")
        if not os.access(place, os.R_OK | os.W_OK):
            return Finding("wrong", "no permission to open", DIALOUT)
        return Finding("ok", "can be opened")
    if Path("/sys/class/net", place).exists():
        return Finding("ok", "the interface exists")
    return Finding("wrong", "no such interface", "correct the channel; `ip link` lists interfaces")
