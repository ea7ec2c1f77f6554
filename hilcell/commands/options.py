"""Options that several commands have, each added in one place."""

from __future__ import annotations

import argparse
from pathlib import Path

from hilcell.commands import arguments


def add_release_options(parser: argparse.ArgumentParser) -> None:
    """Add the conditions under which a calibration is used."""
    parser.add_argument(
        "--temperature",
        type=arguments.finite,
        metavar="T_C",
        help="the room's: refuse one further than 2 K from the calibrated",
    )
    parser.add_argument(
        "--max-age",
        type=arguments.days,
        default=180.0,
        metavar="DAYS",
        help="refuse an older calibration (default: 180)",
    )
    add_accept_options(parser)
    add_runs_option(parser)


def add_accept_options(parser: argparse.ArgumentParser) -> None:
    """Add what a calibration is used in spite of; the output, or the journal, says so."""
    parser.add_argument(
        "--accept-out-of-tolerance",
        action="store_true",
        help="use a calibration whose validation failed, was not made or had another tolerance",
    )
    parser.add_argument(
        "--accept-not-current",
        action="store_true",
        help="use a calibration that is revoked, superseded or out of date",
    )


def add_cell_options(parser: argparse.ArgumentParser) -> None:
    """Add the cell, and values of it."""
    parser.add_argument(
        "--cell",
        default="paper",
        metavar="CELL",
        help="a built-in name or a TOML path (default: paper, simulated)",
    )
    add_set_option(parser)


def add_tool_option(parser: argparse.ArgumentParser) -> None:
    """Add the tool whose tip holes and targets are given at."""
    parser.add_argument(
        "--tool",
        default="",
        metavar="NAME",
        help="the tool of the cell file at whose tip they are given, or `reflector` (default: the "
        "cell's only tool; the reflector where it has none)",
    )


def add_set_option(parser: argparse.ArgumentParser) -> None:
    """Add values that take the place of the cell file's."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        type=arguments.assignment,
        metavar="KEY=VALUE",
        help="override one value of the cell file; may be repeated",
    )


def add_run_argument(parser: argparse.ArgumentParser) -> None:
    """Add a run, and the folder it is in."""
    parser.add_argument("run", metavar="RUN", help="a run's name, its beginning, or `last`")
    add_runs_option(parser)


def add_runs_option(parser: argparse.ArgumentParser) -> None:
    """Add the folder of runs; without it `hilcell.commands.cli.main` finds the usual one."""
    parser.add_argument(
        "--runs",
        type=Path,
        metavar="DIR",
        help="folder of runs (default: HILCELL_RUNS, or one for each user)",
    )


def add_watch_options(parser: argparse.ArgumentParser) -> None:
    """Add who attends a run."""
    parser.add_argument("--unattended", action="store_true", help="nobody is there to ask")
    parser.add_argument(
        "--screen",
        action="store_true",
        help="a screen has ordered this: nothing moves before one attends",
    )
    parser.add_argument(
        "--record-wire",
        action="store_true",
        help="keep all bytes to and from the devices, with times, beside the journal",
    )


def add_bounds_option(parser: argparse.ArgumentParser) -> None:
    """Add the file of bounds."""
    parser.add_argument(
        "--bounds",
        default="",
        metavar="FILE.csv",
        help="also write the 95 %% bound of each target's error, and u of its coordinates",
    )


def add_json_option(parser: argparse.ArgumentParser, text: str) -> None:
    """Add JSON as the form of the answer."""
    parser.add_argument("--json", action="store_true", help=f"print JSON: {text}")


def add_machine_seed_option(command: argparse.ArgumentParser) -> None:
    """Add the seed of the simulated machine."""
    command.add_argument(
        "--machine-seed",
        type=arguments.seed_of,
        default=None,
        metavar="N",
        help="of the simulated machine: robot, rail, tracker (default: the seed; where a run uses "
        "a calibration, that of the calibrated machine)",
    )
