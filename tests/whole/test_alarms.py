"""Every fault that a simulated cell knows, really injected: the run's alarm names it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from _pytest.mark import ParameterSet

from drivers.canopen import drive, nodes
from drivers.kuka import robot as kuka_robot
from drivers.kuka import robot_eki
from drivers.leica.tracker_emscon import LeicaEmsconTracker
from fakes.faults import KNOWN
from hilcell.alarms import Alarm, alarms_of, catalogue
from tests.whole.bench import TOTAL_STATION, ran, simulation

pytestmark = pytest.mark.waits

POINTS = str(Path(__file__).with_name("t2sa_points.csv"))
SHORT = {
    "base_frame.points": "4",
    "layout.nest_samples": "2",
    "plan.unattended_wait_s": "0",
    "rail.standstill_dwell_s": "0.05",
}
CELLS: Mapping[str, Mapping[str, str]] = {
    "": {},
    "EKI": {"robot.driver": "kuka-eki"},
    "E1": {"rail.driver": "kuka-e1"},
    "GeoCOM": TOTAL_STATION,
    "T2SA": {"tracker.driver": "t2sa", "tracker.options.points": POINTS},
    "ABB": {"robot.driver": "abb-egm", "robot.options.model": "KR"},
}
Ends = Mapping[str, tuple[str, object]]

# By cell, the faults that end its run: their alarm, and the value with which they strike.
# Where a strip freezes or the backlash grows, the first alarm depends on where the slide stands.
ENDS: Mapping[str, Ends] = {
    "": {
        "rail.vanish": ("HC-R01", True),
        "rail.wrong_identity": ("HC-R08", 0x999),
        "rail.heartbeat_loss": ("HC-R10", 5),
        "rail.node_reset": ("HC-R03", 5),
        "rail.emcy": ("HC-R24", 0x7305),
        "rail.fault": ("HC-R21", 0x2310),
        "rail.limit_switch": ("HC-R32", -1),
        "rail.no_acknowledge": ("HC-R31", True),
        "rail.overspeed": ("HC-R33", 1.5),
        "rail.bus_off": ("HC-R05", True),
        "rail.second_node": ("HC-R45", 5),
        "rail.sdo_abort": ("HC-R09", 0x06020000),
        "rail.sdo_timeout": ("HC-R05", True),
        "rail.late_reply": ("HC-R05", 0.45),
        "rail.late_tpdo": ("HC-R07", 1.5),
        "rail.strip_frozen": ("HC-S02 HC-S03", True),
        "rail.missing_magnet": ("HC-S01", True),
        "rail.backlash": ("HC-S04 HC-S02 HC-S03", 0.5),
        "rail.slip": ("HC-S03", 5.0),
        "rail.eof": ("HC-R01", True),
        "rail.garbage": ("HC-R05", True),
        "rail.nack": ("HC-R05", True),
        "rail.stalled": ("HC-R05", True),
        "robot.vanish": ("HC-B02", True),
        "robot.wrong_identity": ("HC-B05", "#KR6"),
        "robot.e_stop": ("HC-B10", True),
        "robot.stopmess": ("HC-B14", True),
        "robot.mode_t1": ("HC-B12", True),
        "robot.override_zero": ("HC-B16", True),
        "robot.deselected": ("HC-B15", True),
        "robot.wrong_tool": ("HC-B07", 2),
        "robot.wrong_base": ("HC-B07", 3),
        "robot.softlimit": ("HC-B20", True),
        "robot.stops_short": ("HC-B24", 1.0),
        "robot.frozen": ("HC-B23", True),
        "robot.idle_close": ("HC-B02", True),
        "robot.tag_mismatch": ("HC-B02", True),
        "robot.no_reply": ("HC-B02", True),
        "robot.half_open": ("HC-B02", True),
        "robot.bad_number": ("HC-B26", "NaN"),
        "robot.ack_previous": ("HC-B23", True),
        "robot.failure_footer": ("HC-B03", 0),
        "robot.restarted": ("HC-B03", True),
        "robot.late_reply": ("HC-B02", 3.0),
        "robot.lost_zero": ("HC-T11", 5.0),
        "robot.lost_zero_2": ("HC-T11", 5.0),
        "robot.lost_zero_3": ("HC-T11", 5.0),
        "robot.wrong_turn": ("HC-B24", True),
        "tracker.vanish": ("HC-T02", True),
        "tracker.wrong_identity": ("HC-T03", True),
        "tracker.no_reflector": ("HC-T11", True),
        "tracker.beam_break_before": ("HC-T11", True),
        "tracker.beam_break_after": ("HC-T10", True),
        "tracker.no_result": ("HC-T13", True),
        "tracker.wrong_reflector": ("HC-T12", True),
        "tracker.not_warmed_up": ("HC-T19", True),
        "tracker.no_distance": ("HC-T11", True),
        "tracker.init_lost": ("HC-T04", True),
        "tracker.drift_step": ("HC-T15 HC-T16", 5.0),
        "tracker.noisy": ("HC-T15", 1.0),
        "tracker.metres": ("HC-T18", True),
        "tracker.left_handed": ("HC-T16", True),
        "tracker.no_weather": ("HC-T05", True),
        "tracker.bad_number": ("HC-T14", "nan"),
        "tracker.length_zero": ("HC-T02", True),
        "tracker.length_huge": ("HC-T02", True),
        "tracker.eof": ("HC-T02", True),
        "tracker.wrong_target": ("HC-T16", 500.0),
    },
    "EKI": {
        "robot.xml_bomb": ("HC-B49", True),
        "robot.no_end": ("HC-B49", True),
        "robot.late_reply": ("HC-B02", 3.0),
        "robot.vanish": ("HC-B01", True),
    },
    "ABB": {
        "robot.deselected": ("HC-B83", True),
        "robot.mastership_taken": ("HC-B83", True),
        "robot.motors_off": ("HC-B13", True),
        "robot.speed_ratio": ("HC-B84", 3.0),
        "robot.stream_silent": ("HC-B85", 6.0),
        "robot.stream_time": ("HC-B26", True),
        "robot.second_stream": ("HC-B85", True),
    },
    "E1": {
        "robot.no_slide": ("HC-R50", True),
        "robot.slide_unmastered": ("HC-R51", True),
        "rail.strip_silent": ("HC-S12", True),
        "rail.strip_jump": ("HC-R53", 30.0),
    },
    "GeoCOM": {
        "tracker.geocom_code": ("HC-T51", 1284),
        "tracker.geocom_number": ("HC-T02", True),
        "tracker.geocom_noise": ("HC-T02", True),
        "tracker.no_distance": ("HC-T52", True),
    },
    "T2SA": {
        "tracker.t2sa_simulation": ("HC-T71", True),
        "tracker.t2sa_inches": ("HC-T73", True),
        "tracker.t2sa_renamed": ("HC-T72", True),
        "tracker.t2sa_old_result": ("HC-T76", True),
        "tracker.t2sa_nominal": ("HC-T71", True),
        "tracker.t2sa_code": ("HC-T70", 338),
        "tracker.no_result": ("HC-T13", True),
    },
}
# A driver that is sound goes through these; how often they strike, and with what.
SURVIVED: Mapping[str, Mapping[str, tuple[int, object]]] = {
    "": {
        "rail.early_target_reached": (1000, True),
        "rail.strip_jitter": (20, True),
        "rail.double_frame": (2, True),
        "rail.swapped_frames": (2, True),
        "rail.wrong_mode": (2, 3),
        "tracker.late_result": (1, True),
        "tracker.spike": (1, 0.05),
        "tracker.busy": (2, True),
        "tracker.status_storm": (2, 100),
        "tracker.split_packet": (1000, True),
        "tracker.glued_packets": (1000, True),
    },
    "EKI": {
        "robot.split_reply": (20, True),
        "robot.stale_position": (2, True),
        "robot.glued_reply": (20, True),
    },
}
# Of a device that keeps silent, how long it is waited for in place of several seconds.
WAITS_S: Mapping[str, tuple[object, str, float]] = {
    "rail.bus_off": (nodes, "FIND_S", 0.5),
    "rail.heartbeat_loss": (nodes, "OPERATIONAL_S", 1.0),
    "rail.late_reply": (nodes, "FIND_S", 0.5),
    "rail.no_acknowledge": (drive.Drive, "STALL_S", 1.0),
    "robot.frozen": (kuka_robot, "STALL_S", 1.0),
    "robot.stops_short": (kuka_robot, "REST_S", 1.0),
    "robot.vanish": (robot_eki, "OPEN_S", 0.5),
    "robot.xml_bomb": (robot_eki, "OPEN_S", 0.5),
    "tracker.no_result": (LeicaEmsconTracker, "RESULT_S", 0.1),
}
SPECIFIC = {entry.code for entry in catalogue().values() if entry.specific}


def cases() -> list[ParameterSet]:
    """Return a case a fault; those whose alarm an earlier one has raised are for `make nightly`."""
    found, raised = [], set[str]()
    for cell, ends in ENDS.items():
        for fault, (codes, value) in ends.items():
            later = [pytest.mark.nightly] if codes in raised else []
            name = f"{cell} {fault}".strip()
            found.append(pytest.param(cell, fault, value, codes.split(), id=name, marks=later))
            raised.add(codes)
    return found


def struck(runs: Path, cell: str, faults: Mapping[str, tuple[int, object]]) -> list[Alarm]:
    """Run a small procedure that uses all three devices under faults; return its alarms."""
    values = {**SHORT, **CELLS[cell]}
    with simulation(values=values) as simulated:
        for name, (count, value) in faults.items():
            simulated.strike(name, value, count=count)
        run = ran(runs, "base-frame", values | {"simulation.address": simulated.control})
    return alarms_of(run.log, "x", live=False)


@pytest.mark.parametrize(("cell", "fault", "value", "codes"), cases())
def test_a_fault_that_ends_a_run_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cell: str, fault: str, value: object,
    codes: list[str],
) -> None:  # fmt: skip
    if fault in WAITS_S:
        monkeypatch.setattr(*WAITS_S[fault])
    count = 1 if fault == "rail.strip_jump" else 0  # 0: for ever
    alarms = struck(tmp_path, cell, {fault: (count, value)})
    last = alarms[-1]
    assert last.code in codes, alarms
    assert last.severity == "fault"
    assert last.where
    assert last.found
    assert len(last.do) >= 2
    assert {alarm.code for alarm in alarms} <= SPECIFIC


@pytest.mark.parametrize("cell", SURVIVED)
def test_a_fault_that_is_survived_is_a_notice_at_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cell: str
) -> None:
    monkeypatch.setattr(LeicaEmsconTracker, "RESULT_S", 1.0)  # one comes only with the next
    alarms = struck(tmp_path, cell, SURVIVED[cell])
    assert {alarm.severity for alarm in alarms} <= {"notice"}, alarms
    assert {alarm.code for alarm in alarms} <= SPECIFIC


def test_no_fault_is_left_out() -> None:
    wrists = {f"robot.lost_zero_{axis}" for axis in (4, 5, 6)}
    # Of streams, of a slide in paced time, and those that no device sees: they have other tests.
    others = {"tracker.stream_break", "robot.slide_fast", "robot.mount_slip", "tracker.scale_ppm"}
    others |= {"robot.lost_motion", "robot.growing", "robot.brake_slips", "tracker.turning"}
    others |= {"tracker.unadjusted", "tracker.warming"}
    others |= {"tracker.collimation", "tracker.transit", "tracker.index", "rail.unplugged"}
    # Their alarm depends on the moment: `campaigns.faults` strikes them in each phase.
    timely = {"rail.pushed", "rail.reference_lost"}
    timely |= {"tracker.nest_lifted", "tracker.warmer", "tracker.wrong_offset"}
    ends, survived = ({f for faults in of.values() for f in faults} for of in (ENDS, SURVIVED))
    assert ends | survived | wrists | others | timely == set(KNOWN)
