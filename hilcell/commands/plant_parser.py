"""The words of ``hilcell plant``: its commands and their options."""

from __future__ import annotations

import argparse
from pathlib import Path

from hilcell.commands import arguments, options
from hilcell.commands.parser import Parser


def add_plant(commands: argparse._SubParsersAction[Parser]) -> None:
    """Add the command and those that follow it."""
    text = "keep the records of all cells in one database, and ask it"
    plant = commands.add_parser("plant", help=text, description=text.capitalize() + ".")
    acts = plant.add_commands("plant_command")
    init = _act(acts, "init", "--to", "make the tables, or bring them up to this version's")
    options.add_json_option(init, "one object")
    ship = _act(acts, "ship", "--to", "ship the runs that are over and not there yet")
    ship.add_argument(
        "runs",
        type=arguments.folder,
        nargs="?",
        metavar="DIR",
        help="folder of runs (default: HILCELL_RUNS, or one for each user)",
    )
    options.add_json_option(ship, "one object")
    show = _act(acts, "show", "--from", "show cells, drift of robots, instruments and alarms")
    show.add_argument("--cell", type=arguments.name, metavar="NAME", help="of this cell alone")
    show.add_argument(
        "--robot",
        type=arguments.name,
        metavar="SERIAL",
        help="of this robot and what was with it alone",
    )
    show.add_argument(
        "--max-age",
        type=arguments.days,
        default=180.0,
        metavar="DAYS",
        help="how long a calibration is valid (default: 180)",
    )
    options.add_json_option(show, "one object")
    _add_export(acts)
    _add_verify(acts)


def _add_export(acts: argparse._SubParsersAction[Parser]) -> None:
    export = _act(acts, "export", "--from", "write the record of one cell for an auditor, signed")
    export.set_defaults(act="commands.plant_export:export")
    export.add_argument("cell", metavar="CELL", help="name of the cell")
    export.add_argument("--serial", metavar="SERIAL", help="of the cell with this serial number")
    export.add_argument(
        "-o", dest="out", type=Path, required=True, metavar="FOLDER|FILE.zip", help="a new place"
    )
    export.add_argument(
        "--key", type=Path, required=True, metavar="KEYFILE", help="private key, Ed25519 in PEM"
    )
    options.add_json_option(export, "one object")


def _add_verify(acts: argparse._SubParsersAction[Parser]) -> None:
    text = "verify an exported record: each file that differs, is missing or is extra"
    verify = acts.add_parser("verify", help=text, description=text.capitalize() + ".")
    verify.set_defaults(act="commands.plant_export:verify")
    verify.add_argument("record", type=Path, metavar="FOLDER|FILE.zip", help="what was exported")
    verify.add_argument(
        "--public-key", type=Path, required=True, metavar="FILE", help="the plant's, in PEM"
    )
    options.add_json_option(verify, "one object")


def _act(
    acts: argparse._SubParsersAction[Parser], name: str, where: str, text: str
) -> argparse.ArgumentParser:
    act = acts.add_parser(name, help=text, description=text.capitalize() + ".")
    act.set_defaults(act=f"commands.plant:{name}")
    act.add_argument(
        where,
        dest="plant",
        metavar="URL",
        help="the plant's database (default: HILCELL_PLANT): postgresql://USER@HOST/DATABASE, "
        "its password in ~/.pgpass, or sqlite:///FILE",
    )
    return act
