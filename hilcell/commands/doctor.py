"""``doctor``: check this PC, and on request the places of a cell's devices; nothing moves."""

from __future__ import annotations

import os
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path

from hilcell.alarms.catalogue import CatalogueError, catalogue
from hilcell.cell.addresses import THIS_MACHINE
from hilcell.cell.devices import PORTS, check_options, device_places, installed, load_entry
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.clean import harmless_lines
from hilcell.commands import this_pc
from hilcell.commands.orders import Doctor
from hilcell.commands.output import print_data, print_json
from hilcell.commands.this_pc import Finding
from hilcell.run.cell_lock import CellLocked, lock_of_device, locked
from hilcell.run.exits import EXIT_REFUSED
from hilcell.tui.keys import default_file, load_keys

CONNECT_S = 2.0
PARTS = (*PORTS, *(f"simulated_{group}" for group in PORTS), "programs", "program_writers")
SHOWN = {"ok": "ok", "warning": "note", "wrong": "WRONG"}


def doctor(args: Doctor) -> int:
    """Print what was checked; exit code 2 where something has to be mended before a run."""
    found = list(_of_this_pc(args.runs))
    if args.cell:
        found += _of_cell(args.cell, dict(args.settings))
    sound = all(each.state != "wrong" for each in found)
    if args.json:
        print_json({"ok": sound, "checks": [each._asdict() for each in found]})
    else:
        print_data(harmless_lines("\n".join(line for each in found for line in _lines(each))))
    return 0 if sound else EXIT_REFUSED


def _lines(finding: Finding) -> Iterator[str]:
    yield f"{SHOWN[finding.state]:6} {finding.check:13} {finding.found}"
    if finding.do:
        yield f"{'':20} -> {finding.do}"


def _of_this_pc(runs: Path) -> Iterator[Finding]:
    yield this_pc.python()
    yield this_pc.terminal(os.environ, *shutil.get_terminal_size())
    yield this_pc.can()
    yield this_pc.serial_ports()
    yield this_pc.loopback()
    yield this_pc.disk(runs)
    yield this_pc.clock(runs)
    yield this_pc.locks()
    yield this_pc.pace()
    yield this_pc.browser()
    yield _keys()
    yield _drivers()


def _keys() -> Finding:
    try:
        load_keys(None)
    except SettingsError as error:
        return Finding("keys", "wrong", str(error), f"mend {default_file()}")
    file = default_file()
    return Finding("keys", "ok", str(file) if file.exists() else "as delivered")


def _drivers() -> Finding:
    """Load every driver and all that belongs to it, also those of packages beside hilcell."""
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
        return Finding("drivers", "warning", "; ".join(problems), "mend or uninstall its package")
    found = "; ".join(f"{group} {', '.join(installed(group))}" for group in (*PORTS, "programs"))
    return Finding("drivers", "ok", found)


def _of_cell(where: str, overrides: dict[str, str]) -> Iterator[Finding]:
    """Check the places at which a cell's devices are reached; raises `SettingsError`."""
    cell = load_cell(where, overrides)
    check_options(cell)
    if cell.simulation is not None:
        yield Finding("cell", "ok", f"{cell.name}: simulated; a run starts its devices")
        return
    for place, tables in device_places(cell, {}).items():
        if tables == ["rail"] and not cell.has_rail:
            continue
        yield _in_use_or(f"{' and '.join(tables)} at {place}", place)


def _in_use_or(check: str, place: str) -> Finding:
    """Check a place unless a run holds it: a connection could disturb that run."""
    try:
        with locked(lock_of_device(place), check, "hilcell doctor"):
            return _place(check, place)
    except CellLocked as error:
        return Finding(check, "ok", f"in use: {error}")


def _place(check: str, place: str) -> Finding:
    if place.startswith("{"):  # all options of a driver that has other words for its place
        return Finding(check, "ok", "not checked: its driver names no host, port or channel")
    host, sign, port = place.rpartition(":")
    if sign and port.isdecimal():
        return _network(check, host, int(port))
    if place.startswith("/"):
        return _file(check, Path(place))
    if Path("/sys/class/net", place).exists():
        return Finding(check, "ok", "this PC has the interface")
    return Finding(
        check, "wrong", "this PC has no such interface", "`ip link` lists them; correct the channel"
    )


def _network(check: str, host: str, port: int) -> Finding:
    address = "127.0.0.1" if host == THIS_MACHINE else host
    try:
        socket.create_connection((address, port), timeout=CONNECT_S).close()
    except OSError as error:
        return Finding(
            check, "wrong", f"no connection: {error.strerror or error}",
            "switch the device on, check its cable, its address and the port",
        )  # fmt: skip
    return Finding(check, "ok", "accepts a connection")


def _file(check: str, port: Path) -> Finding:
    if not port.exists():
        return Finding(check, "wrong", "no such port", "plug its adapter in, or correct channel")
    if not os.access(port, os.R_OK | os.W_OK):
        return Finding(
            check, "wrong", "may not be opened by this user",
            "sudo usermod -a -G dialout $USER, then log in again",
        )  # fmt: skip
    return Finding(check, "ok", "can be opened")
