"""The words of ``hilcell plant``: its three commands and their options."""

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
        type=Path,
        nargs="?",
        metavar="DIR",
        help="folder of runs (default: HILCELL_RUNS, or one for each user)",
    )
    options.add_json_option(ship, "one object")
    show = _act(acts, "show", "--from", "show cells, drift of robots, instruments and alarms")
    show.add_argument("--cell", default="", metavar="NAME", help="of this cell alone")
    show.add_argument("--robot", default="", metavar="SERIAL", help="the drift of this robot alone")
    show.add_argument(
        "--max-age",
        type=arguments.days,
        default=180.0,
        metavar="DAYS",
        help="how long a calibration is valid (default: 180)",
    )
    options.add_json_option(show, "one object")


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
