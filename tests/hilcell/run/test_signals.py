"""Signals reach a run whichever thread the system hands them to."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hilcell.ports import Stopped
from hilcell.run.signals import signals_as_commands, stopped_by_signals

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


def test_one_handed_to_another_thread_stops_the_run(tmp_path: Path) -> None:
    """The main thread's wait is not broken by it, as by one that comes just before the wait."""
    done = subprocess.run(
        [sys.executable, "-c", ELSEWHERE, str(tmp_path)],
        cwd=ROOT,
        timeout=60,
        check=False,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert done.returncode == 4
    assert done.stdout == "stopped by SIGTERM\n"


def test_signals_become_commands_and_are_given_back() -> None:
    told: list[str] = []
    before = signal.getsignal(signal.SIGHUP)
    with signals_as_commands(told.append):
        for number in (signal.SIGHUP, signal.SIGTERM, signal.SIGINT):
            signal.raise_signal(number)
    assert told == ["lost", "terminate", "interrupt"]
    assert signal.getsignal(signal.SIGHUP) is before


def test_before_a_run_lives_a_signal_ends_it() -> None:
    with (
        pytest.raises(Stopped, match="stopped by SIGHUP before anything moved"),
        stopped_by_signals(),
    ):
        signal.raise_signal(signal.SIGHUP)
