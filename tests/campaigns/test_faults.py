"""Two cases of the campaign of faults; its table and its page are in order."""

from __future__ import annotations

import re

import pytest

from campaigns.__main__ import main
from campaigns.faults.bed import hasten
from campaigns.faults.campaign import TABLES, cases, judge_case
from campaigns.faults.injections import Knob
from campaigns.faults.judging import judged
from campaigns.faults.page import PAGE
from campaigns.faults.phases import Event, Phase
from campaigns.faults.script import Case, Ran
from campaigns.faults.table import FAULTS
from tests.whole.bench import sweep

SOME = [
    (Case(46, Knob("robot.e_stop", count=1), Phase.PAUSED), "safe stop HC-B10"),
    (Case(11, Knob("rail.emcy", 0x4210, 1), Phase.TEARDOWN), "stopped"),
    (Case(2, Knob("robot.deselected", count=1), Phase.ROBOT, cell="abb"), "safe stop HC-B83"),
    *sweep(
        (
            Case(29, Knob("tracker.beam_break_after", count=6), Phase.MEASURING),
            "suspended, went on",
        ),
        (Case(29, Knob("tracker.beam_break_after"), Phase.PAUSED), "safe stop HC-T10"),
        (Case(10, Knob("rail.node_reset", 5, 1), Phase.ROBOT), "safe stop HC-R03"),
        (Case(44, Knob("robot.bad_number", "1e308"), Phase.RESUMING), "safe stop HC-B26"),
    ),
]


@pytest.mark.wall
@pytest.mark.parametrize(("case", "reaction"), SOME)
def test_a_fault_in_a_phase(case: Case, reaction: str, monkeypatch: pytest.MonkeyPatch) -> None:
    hasten(monkeypatch.setattr)
    verdict = judge_case(case)
    assert verdict.problems == ()
    assert verdict.reaction == reaction


def ran_to(exit_code: int, *events: Event) -> Ran:
    return Ran([*events], [exit_code], "", [], struck=True, session=1, T_W_B=[])


END: Event = {"kind": "end", "exit": 3, "error": {"code": "HC-C32"}}
NO_READING: Event = {"kind": "event", "what": "no reading"}


@pytest.mark.parametrize(
    ("number", "phase", "ran", "reaction", "holds"),
    [
        (32, Phase.ROBOT, ran_to(1, NO_READING), "finished, exit 1", True),  # and not "went on"
        (32, Phase.ROBOT, ran_to(0, NO_READING), "tried again, went on", False),
        (6, Phase.ROBOT, ran_to(3, END), "safe stop HC-C32", True),
        (6, Phase.MEASURING, ran_to(3, END), "safe stop HC-C32", False),
        (6, Phase.RAIL, ran_to(3, END), "safe stop HC-C32", False),  # it is asked before
        (46, Phase.ROBOT, ran_to(3, END), "safe stop HC-C32", False),  # a robot's fault
    ],
)
def test_the_end_of_a_run_is_judged(
    number: int, phase: Phase, ran: Ran, reaction: str, holds: bool
) -> None:
    fault = next(each for each in FAULTS if each.number == number)
    found = judged(fault, Case(number, Knob("robot.e_stop", lasts=True), phase), ran, ran_to(0))
    assert found.reaction == reaction
    assert (found.problems == ()) is holds


def test_the_table_is_in_order_and_its_cases_are_distinct() -> None:
    for cell, table in TABLES.items():
        numbers = [fault.number for fault in table]
        assert numbers == sorted(set(numbers))
        everything = list(cases(cell=cell))
        assert len(set(everything)) == len(everything)


def test_the_page_is_of_this_table() -> None:
    text = PAGE.read_text("utf-8")
    rows = re.findall(r"^\| (\d+) \| ([^|]+) \| ([^|]+) \|", text, re.MULTILINE)
    assert [(int(number), name, wanted) for number, name, wanted in rows] == [
        (fault.number, fault.name, fault.reaction) for fault in FAULTS
    ]
    assert "BROKEN" not in text


@pytest.mark.parametrize(
    "words", [("faults", "999"), ("faults", "kills", "--count", "0"), ("kills", "--count", "-5")]
)
def test_words_that_name_no_case_are_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as refused:
        main([*words])
    assert refused.value.code == 2
