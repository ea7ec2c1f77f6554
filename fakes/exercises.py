"""Training exercises: faults in plain words, each with the alarm that a run usually raises.

The alarm may differ: it depends on what the run does next.
``python -m fakes.exercises`` writes the manual's page of them, and of all faults on demand.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from fakes.faults import KNOWN, TEXTS, UNTIL_CLEARED, Value
from fakes.kuka.controller import RAIL_DRIVER
from hilcell.cell.file import Cell
from hilcell.ports import Exercise


@dataclass(frozen=True, slots=True)
class FaultExercise(Exercise):
    """An exercise by one fault of the simulated cell, injected ``count`` times."""

    fault: str
    value: Value = True
    count: int = 1


def _lasting(title: str, alarm: str, fault: str, value: Value = True) -> FaultExercise:
    return FaultExercise(title, alarm, fault, value, UNTIL_CLEARED)


EXERCISES: Sequence[FaultExercise] = (
    _lasting("the tracker's beam is blocked", "HC-T10", "tracker.beam_break_after"),
    _lasting("a reflector has fallen out of its nest", "HC-T11", "tracker.no_reflector"),
    _lasting("a reflector is dirty or vibrates", "HC-T15", "tracker.noisy", 1.0),
    _lasting("the weather station is unplugged", "HC-T05", "tracker.no_weather"),
    _lasting("the tracker has not warmed up", "HC-T19", "tracker.not_warmed_up"),
    _lasting("the tracker is out of adjustment", "HC-V23", "tracker.unadjusted", 50.0),
    FaultExercise("the tracker is still warming up", "HC-V24", "tracker.warming", 200.0),
    FaultExercise("the tracker's network cable was pulled", "HC-T02", "tracker.eof"),
    FaultExercise("the E-stop was pressed", "HC-B10", "robot.e_stop"),
    FaultExercise("the key switch was turned to T1", "HC-B12", "robot.mode_t1"),
    FaultExercise("the override was turned down to 0", "HC-B16", "robot.override_zero"),
    FaultExercise("the program was deselected at the panel", "HC-B15", "robot.deselected"),
    FaultExercise("the robot has hit something", "HC-B14", "robot.stopmess"),
    FaultExercise("the robot's network cable was pulled", "HC-B02", "robot.idle_close"),
    FaultExercise("the slide has run onto its limit switch", "HC-R32", "rail.limit_switch", -1),
    FaultExercise("the drive draws too much current", "HC-R21", "rail.fault", 0x2310),
    FaultExercise("the drive's supply was interrupted", "HC-R03", "rail.node_reset", 5),
    FaultExercise("the CAN gateway's plug was pulled", "HC-R01", "rail.eof"),
    FaultExercise("the held slide was pushed", "HC-S05", "rail.pushed", 30.0),
    _lasting("the strip's head has lost its strip", "HC-S01", "rail.missing_magnet"),
)


# Of robots whose controllers show a fault otherwise than a KUKA, by driver.
ALARMS: Mapping[str, Mapping[str, str]] = {
    "abb-egm": {"robot.deselected": "HC-B83"},
    "ur-rtde": {
        "robot.mode_t1": "HC-B60",
        "robot.deselected": "HC-B66",
        "robot.stopmess": "HC-B62",
    },
}


def cell_exercises(cell: Cell) -> Sequence[FaultExercise]:
    """Return the exercises of a cell: none of a rail, or a bus, that it lacks."""
    lacks: tuple[str, ...] = () if cell.has_rail else ("rail.",)
    on_the_bus = ("rail.limit_switch", "rail.fault", "rail.node_reset", "rail.eof")
    if cell.rail.driver == RAIL_DRIVER:
        lacks = on_the_bus
    alarms = ALARMS.get(cell.robot.driver, {})
    return [
        replace(each, alarm=alarms.get(each.fault, each.alarm))
        for each in EXERCISES
        if not each.fault.startswith(lacks)
    ]


PAGE = """# Training, and faults on demand

## Training

`hilcell sim --train` runs the simulated cell and offers faults to practise on. In another terminal
`hilcell tui`, or `hilcell run` with the printed `--set simulation.address=...`, works on that cell.

| key | effect |
|---|---|
| a number | injects that fault |
| Enter | injects a fault without naming it: diagnose it by the screen and the alarm |
| Enter again | names fault, alarm and steps, and repairs the cell; then resume the run |
| `m` | lists the faults again |
| `q`, or ctrl-C | ends the simulated cell |

| fault | [alarm](alarms.md) |
|---|---|
{exercises}

## Example: a mount that slipped between two calibrations

The simulated cell is calibrated; then, as weeks later, its reflector sits 0.3 mm beside its
place, and the cell is [re-calibrated](recheck.md#re-calibrate-in-five-minutes):

```
hilcell run --name first
printf '[[fault]]\\nname = "robot.mount_slip"\\nvalue = 0.3\\n' > slipped.toml
hilcell sim --speed max --faults slipped.toml    # in another terminal; it prints ADDRESS
hilcell run --from first --name second --set simulation.address=ADDRESS
```

The run pauses after the two circles of the base frame: *suspected: mount slipped (0.3 mm),
noticed by circles of run first*. No target would have shown it, since the correction follows the
reflector. Ctrl-C ends the run: seat the reflector, that is, start `hilcell sim --speed max`
without the fault, and run the last line again. Without the slip it takes 4.4 minutes of the
cell's time, and `hilcell runs` has *calibrate from first*, which is current.

## Faults on demand

`hilcell sim --faults FILE` injects faults from a TOML file:

```toml
[[fault]]
name = "rail.emcy"
value = 0x7305  # omitted: the fault's default
after = 2       # occasions that pass first
count = 1       # number of injections; 0: until it is cleared
at_rest = false # true: a fault that waits for a motion is also injected at rest
```

Names and effects (values), grouped by device and occasion. Values are numbers, or text for names
marked *.

| name | effect |
|---|---|
{faults}
"""


def page() -> str:
    exercises = [f"| {each.title} | {each.alarm} |" for each in EXERCISES]
    by_occasion: dict[str, list[str]] = {}
    for name, text in KNOWN.items():
        effect, _, occasion = text.rpartition(" | ")
        by_occasion.setdefault(f"{name.partition('.')[0]}: {occasion}", []).append(
            f"| `{name}`{' *' if name in TEXTS else ''} | {effect} |"
        )
    faults = [
        line for occasion, rows in by_occasion.items() for line in (f"| **{occasion}** | |", *rows)
    ]
    return PAGE.format(exercises="\n".join(exercises), faults="\n".join(faults))


if __name__ == "__main__":
    sys.stdout.write(page())
