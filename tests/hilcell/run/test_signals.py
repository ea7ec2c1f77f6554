"""Signals reach a run whichever thread the system hands them to."""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from hilcell.ports import DeviceError, Stopped
from hilcell.run.cell_session import CellSession
from hilcell.run.signals import (
    interrupted_once,
    note_signals,
    postponed,
    signals_as_commands,
    stopped_by_signals,
)
from tests.hilcell.run.bed import Bed
from tests.hilcell.run.rig import Points, procedure

ROOT = Path(__file__).parents[3]
ELSEWHERE = """
import signal, sys, threading
from pathlib import Path
from tests.hilcell.run.bed import Bed, until
from tests.hilcell.run.rig import Points, procedure

bed = Bed(Path(sys.argv[1]))
runner = bed.runner(procedure(Points(10**6)))

def deliver():
    until(lambda: runner.status().points > 5)
    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)

threading.Thread(target=deliver).start()
code = runner.run()
print(runner.fault)
sys.exit(code)
"""


@pytest.mark.process
def test_one_handed_to_another_thread_stops_the_run(tmp_path: Path) -> None:
    """The main thread's wait is not broken by it, as by one that comes just before the wait."""
    done = subprocess.run(
        [sys.executable, "-c", ELSEWHERE, str(tmp_path)],
        cwd=ROOT,
        check=False,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert done.returncode == 4
    assert "SIGTERM" in done.stdout


def test_signals_become_commands_and_are_given_back() -> None:
    told: list[str] = []
    before = signal.getsignal(signal.SIGHUP)
    with signals_as_commands(told.append):
        for number in (signal.SIGHUP, signal.SIGTERM, signal.SIGINT):
            signal.raise_signal(number)
    assert told == ["lost", "terminate", "interrupt"]
    assert signal.getsignal(signal.SIGHUP) is before


def left(noted: list[signal.Signals]) -> None:
    """Start, get a signal, and another on the way out."""
    with stopped_by_signals(noted):
        try:
            signal.raise_signal(signal.SIGHUP)
        finally:
            signal.raise_signal(signal.SIGINT)
            noted.append(signal.SIGTERM)  # it came so far


def test_while_a_run_starts_a_signal_ends_it_and_later_ones_do_not_interrupt_its_way_out() -> None:
    noted = note_signals()
    with pytest.raises(Stopped, match="SIGHUP"):
        left(noted)
    assert noted == [signal.SIGHUP, signal.SIGINT, signal.SIGTERM]
    signal.raise_signal(signal.SIGTERM)


def interrupted(number: signal.Signals) -> list[str]:
    """Get a signal where Python loses its exception, and another on the way out."""
    steps = []
    try:
        with interrupted_once() as check:
            check()
            with suppress(KeyboardInterrupt):  # as a callback of the garbage collection does
                signal.raise_signal(number)
            steps.append("it is lost")
            try:
                check()
            finally:
                signal.raise_signal(number)
                steps.append("the way out")
    except KeyboardInterrupt:
        steps.append("interrupted")
    return steps


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_interrupts_once_and_is_not_lost(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    assert interrupted(number) == ["it is lost", "the way out", "interrupted"]
    assert signal.getsignal(number) is before


def test_signals_that_are_ignored_stay_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """As SIGHUP under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interrupted_once() as check, postponed(signal.SIGHUP):
            signal.raise_signal(signal.SIGHUP)
        check()
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_postponed_signal_comes_at_the_end() -> None:
    steps = []
    try:
        with interrupted_once():
            with postponed(signal.SIGTERM):
                signal.raise_signal(signal.SIGTERM)
                steps.append("done")
            steps.append("not reached")
    except KeyboardInterrupt:
        steps.append("interrupted")
    assert steps == ["done", "interrupted"]


def test_a_signal_noted_while_the_run_is_set_up_stops_it(bed: Bed) -> None:
    runner = bed.runner(procedure(Points(10**6)))
    assert runner.run([signal.SIGTERM]) == 4
    bed.journal.close()
    assert bed.states()[-1] == "aborted"


def three() -> None:
    """Press ctrl-C three times, and have the system end the process."""
    for number in (signal.SIGINT, signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGTERM):
        os.kill(os.getpid(), number)


@pytest.mark.parametrize("ends_well", [True, False])
def test_signals_while_a_run_is_torn_down_change_nothing(
    bed: Bed, monkeypatch: pytest.MonkeyPatch, ends_well: bool
) -> None:
    """Devices are closed once, and the journal says how the run ended."""
    close = bed.rail.close

    def closing() -> None:
        three()
        close()
        three()

    def fail(session: CellSession, number: int) -> None:
        if not ends_well:
            raise DeviceError("HC-R31", "Rail", "move", "frozen")

    monkeypatch.setattr(bed.rail, "close", closing)
    runner = bed.runner(procedure(Points(1, fail)))
    ends = ("closed", "finished", "faulted")
    bed.journal.listen(  # in the middle of a commit
        lambda record: three() if {*ends} & {*map(str, record.body.values())} else None
    )
    assert runner.run() in ((0,) if ends_well else (3,))
    bed.journal.close()
    assert bed.rail.closed == 1


def test_ctrl_c_three_times_stops_a_run_in_good_order(bed: Bed) -> None:

    def pressed(session: CellSession, number: int) -> None:
        if number == 2:
            three()

    assert bed.run(procedure(Points(10**6, pressed))) == 4
    assert bed.states()[-2:] == ["stopping", "aborted"]
    assert bed.log().end is not None
    assert bed.rail.closed == 1
