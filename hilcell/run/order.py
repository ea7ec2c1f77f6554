"""Orders: of a run, of who attends it, and of the calibration that may be used."""

from __future__ import annotations

from typing import Annotated

from hilcell.arguments import (
    Argument,
    CellName,
    JsonLines,
    MachineSeed,
    NotCurrent,
    Noted,
    OutOfTolerance,
    Runs,
    Settings,
    Signature,
    days,
    finite,
    run_name,
    seed_of,
    speed_of,
)
from hilcell.clean import clean


class Attendance(Signature):
    """The operator, a screen and a recording at a run."""

    unattended: Annotated[bool, Argument("nobody is there to ask")] = False
    screen: Annotated[
        bool, Argument("a screen has ordered this: nothing moves before one attends")
    ] = False
    record_wire: Annotated[
        bool,
        Argument("keep all bytes to and from the devices, with times, beside the journal"),
    ] = False


class Order(Signature):
    """Perform a procedure on a cell."""

    procedure: Annotated[str, Argument("default: calibrate", word=True)] = "calibrate"
    cell: CellName = "paper"
    settings: Settings = ()
    seed: Annotated[
        int,
        Argument(
            "of random targets; of the simulated machine, too, unless it has its own (default: 1)",
            "N",
            seed_of,
        ),
    ] = 1
    machine_seed: MachineSeed = None
    runs: Runs
    speed: Annotated[
        float | None,
        Argument(
            "of a simulated cell's time: a factor, or as fast as it goes (default: max)",
            "X|max",
            speed_of,
        ),
    ] = None
    attendance: Attendance = Attendance()
    operator: Noted = ""
    name: Annotated[
        str | None,
        Argument(
            "the run's name and folder (default: made of time and procedure)", "RUN", run_name
        ),
    ] = None
    job: Annotated[str, Argument("kept in the journal", "ID", clean)] = ""
    accept_out_of_tolerance: OutOfTolerance = False
    accept_not_current: NotCurrent = False
    dry_run: Annotated[bool, Argument("check and show the plan; open nothing")] = False
    json: JsonLines = False


class Release(Signature):
    """The conditions under which a calibration is used, and where runs are."""

    temperature: Annotated[
        float | None,
        Argument("the room's: refuse one further than 2 K from the calibrated", "T_C", finite),
    ] = None
    max_age: Annotated[
        float, Argument("refuse an older calibration (default: 180)", "DAYS", days)
    ] = 180.0
    accept_out_of_tolerance: OutOfTolerance = False
    accept_not_current: NotCurrent = False
    runs: Runs
