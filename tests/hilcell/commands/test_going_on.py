"""A person agrees to the motion that was announced last, and to none that was agreed to."""

from hilcell.commands.run import awaited_motion
from tests.hilcell.alarms.journals import event, log_of, state

RUNNING = state("running")
FIRST, SECOND = (event("announced", motion=motion) for motion in ("A1 turns", "A6 turns"))


def test_the_motion_that_a_run_waits_for_is_the_last_that_nobody_has_agreed_to() -> None:
    assert awaited_motion(log_of(RUNNING)) == ""
    assert awaited_motion(log_of(RUNNING, FIRST, state("paused"))) == "A1 turns"
    assert awaited_motion(log_of(RUNNING, FIRST, state("paused"), RUNNING)) == ""
    assert awaited_motion(log_of(RUNNING, FIRST, RUNNING, SECOND, state("paused"))) == "A6 turns"
