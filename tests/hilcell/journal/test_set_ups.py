"""Points of a tracker that is framed again by another engine count no longer."""

from tests.hilcell.alarms.journals import event, log_of, point


def test_nests_of_a_frame_that_was_begun_again_are_no_points_any_more() -> None:
    measured = point("world/F1"), point("grid/1-0-0")
    again = event("world frame begun again", invalid=["world/F1"])
    assert [*log_of(*measured).points] == ["world/F1", "grid/1-0-0"]
    assert [*log_of(*measured, again).points] == ["grid/1-0-0"]
    assert [*log_of(*measured, again, point("world/F1")).points] == ["grid/1-0-0", "world/F1"]
