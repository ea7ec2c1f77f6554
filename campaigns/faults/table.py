"""The catalogue of faults: number, name, reaction, and how each is brought about.

``reaction`` is that of the catalogue: R bounded retry, P pause or suspend, S safe stop and latch,
X refuse, I invalidate and measure again, L refuse the second, "-" must go on as if nothing were.
``ends`` are the ends that a case may have in the three phases in which devices work: its letters
are those of `campaigns.faults.judging`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from signal import SIGHUP, SIGINT, SIGTERM

from campaigns.faults.injections import (
    Clock,
    Corrupted,
    EditedCell,
    FullDisk,
    Injection,
    Kill,
    Knob,
    NothingDone,
    SecondEngine,
    Signals,
    Wire,
)
from campaigns.faults.phases import Phase

RAIL, ROBOT, MEASURING = Phase.RAIL, Phase.ROBOT, Phase.MEASURING
PAUSED, RESUMING, TEARDOWN = Phase.PAUSED, Phase.RESUMING, Phase.TEARDOWN
DEVICES = ("rail", "robot", "tracker")


@dataclass(frozen=True)
class Fault:
    """One row: where ``skipped`` has a phase, it says in two words why the fault has none there."""

    number: int
    name: str
    reaction: str
    ends: str
    codes: tuple[str, ...]  # how the code of the alarm begins
    injections: tuple[Injection, ...]
    skipped: Mapping[Phase, str] = field(default_factory=dict)
    procedure: str = "base-frame"


def only(phases: Sequence[Phase], why: str) -> dict[Phase, str]:
    """Return why a fault has none of the other phases."""
    return {phase: why for phase in Phase if phase not in phases}


def _all_wires(mode: str, delay_s: float = 0.0) -> tuple[Wire, ...]:
    return tuple(Wire(device, mode, delay_s) for device in DEVICES)


R, B, T, C = ("HC-R", "HC-S"), ("HC-B",), ("HC-T",), ("HC-C", "HC-J", "HC-K")
ANY = (*R, *B, *T)
AT_START = only([RESUMING], "read once")
AT_CONNECT = only([RESUMING], "at connect")

FAULTS = (
    Fault(1, "CAN bus-off", "S", "S", R, (Knob("rail.bus_off"),)),
    Fault(
        2, "CAN interface gone", "S", "S", R, (Knob("rail.eof"), Knob("rail.vanish", lasts=True))
    ),
    Fault(3, "wrong bit rate, or no node", "X", "S", R, (Knob("rail.stalled"),), AT_CONNECT),
    Fault(
        4,
        "two nodes with one number",
        "X",
        "-S",
        R,
        (Knob("rail.second_node", 5), Knob("rail.second_node", 6)),
        AT_CONNECT,
    ),
    Fault(
        5,
        "SDO abort",
        "X at set-up, S in motion",
        "-S",
        R,
        (Knob("rail.sdo_abort", 0x06020000), Knob("rail.sdo_abort", 0x08000022)),
    ),
    Fault(6, "SDO timeout", "R2, then S", "-S", R, (Knob("rail.sdo_timeout"),)),
    Fault(
        7, "late SDO reply taken as the next", "R", "-RS", R, (Knob("rail.late_reply", 0.45, 2),)
    ),
    Fault(
        8,
        "CAN frame doubled, or out of order",
        "must work",
        "-",
        R,
        (Knob("rail.double_frame", count=2), Knob("rail.swapped_frames", count=2)),
    ),
    Fault(
        9,
        "lost heartbeat",
        "S",
        "S",
        R,
        (Knob("rail.heartbeat_loss", 5, wait_s=1.3), Knob("rail.heartbeat_loss", 6, wait_s=1.3)),
    ),
    Fault(
        10,
        "node reset in the run",
        "S, home again",
        "S",
        R,
        (Knob("rail.node_reset", 5, 1), Knob("rail.node_reset", 6, 1)),
    ),
    Fault(11, "EMCY", "S with the code's text", "S", R, (Knob("rail.emcy", 0x4210, 1),)),
    Fault(12, "following error", "S", "S", R, (Knob("rail.fault", 0x8611, 1),)),
    Fault(13, "drive fault", "S", "S", R, (Knob("rail.fault", 0x2310, 1),)),
    Fault(
        14,
        "target never reached",
        "S",
        "S",
        R,
        (Knob("rail.no_acknowledge"),),
        only([RAIL, RESUMING], "no motion"),
    ),
    Fault(
        15,
        "`target reached` lies",
        "S",
        "-S",
        R,
        (Knob("rail.early_target_reached"),),
        only([RAIL, RESUMING], "no motion"),
    ),
    Fault(16, "limit switch", "S", "S", R, (Knob("rail.limit_switch", -1, 1),)),
    Fault(17, "overspeed", "S", "S", R, (Knob("rail.overspeed", 1.5),), only([RAIL], "no motion")),
    Fault(18, "slide slips after the stop", "S, I", "-S", R, (Knob("rail.pushed", 0.3, 1),)),
    Fault(
        19,
        "strip slips, counts lost",
        "I, P",
        "-S",
        R,
        (Knob("rail.strip_jump", 0.5, 1, lasts=True),),
    ),
    Fault(20, "strip jumps a pole", "P, I", "S", R, (Knob("rail.strip_jump", 5.0, 1, lasts=True),)),
    Fault(
        21,
        "strip dirty: noise, dropout",
        "R, then P",
        "-RPS",
        R,
        (
            Knob("rail.missing_magnet", count=2),
            Knob("rail.missing_magnet", count=60),
            Knob("rail.missing_magnet"),
            Knob("rail.strip_frozen", count=60),
            Knob("rail.strip_frozen"),
        ),
    ),
    Fault(
        22,
        "encoder wraps",
        "X where outside",
        "-S",
        R,
        (Knob("rail.reference_lost", 2147483.0, 1),),
    ),
    Fault(23, "backlash grows", "P, report", "-S", R, (Knob("rail.backlash", 0.3, 1),)),
    Fault(24, "approach from the wrong side", "X", "", (), (), only([], "engine's own")),
    Fault(25, "drive not homed", "X", "-S", R, (Knob("rail.reference_lost", 37.0, 1),)),
    Fault(
        26,
        "rail moved by hand in a pause",
        "P, station held again",
        "-S",
        R,
        (Knob("rail.pushed", 30.0, 1),),
    ),
    Fault(
        27,
        "station wrong or undefined",
        "X",
        "X",
        C,
        (EditedCell('"S1900"\nrail_mm = 1900.0', '"S1900"\nrail_mm = 9900.0'),),
        AT_START,
    ),
    Fault(
        28,
        "the room grows warmer",
        "P, I",
        "PS",
        ("HC-V14",),
        (Knob("tracker.warmer", 6.0, 1, lasts=True),),
        procedure="calibrate",
    ),
    Fault(
        29,
        "beam break",
        "R, then P",
        "RPS",
        T,
        (
            Knob("tracker.beam_break_before", count=2),
            Knob("tracker.beam_break_after", count=2),
            Knob("tracker.beam_break_after"),
        ),
    ),
    Fault(
        30, "beam caught by another SMR", "P, I", "RPS", T, (Knob("tracker.wrong_target", 500.0),)
    ),
    Fault(
        31,
        "SMR of another size or offset",
        "X",
        "INSP",
        (*R, *T),
        (Knob("tracker.wrong_offset", 6.35, 1, lasts=True),),
        procedure="calibrate",
    ),
    Fault(
        32,
        "SMR not seated",
        "P",
        "INS",
        (*R, *T),
        (Knob("tracker.nest_lifted", 3.0, 1, lasts=True),),
        procedure="calibrate",
    ),
    Fault(
        33,
        "dirty SMR",
        "R, then P",
        "RPS",
        T,
        (Knob("tracker.noisy", 1.0, 2), Knob("tracker.noisy", 1.0)),
    ),
    Fault(
        34,
        "tracker bumped",
        "I the block, P",
        "IPS",
        T,
        (Knob("tracker.drift_step", 1.0, 1, lasts=True),),
        procedure="calibrate",
    ),
    Fault(
        35,
        "tracker drifts slowly",
        "P at the limit",
        "S",
        T,
        (Knob("tracker.drift_step", 0.02, lasts=True),),
    ),
    Fault(36, "warm-up missing", "X or warn", "RPS", T, (Knob("tracker.not_warmed_up"),)),
    Fault(37, "weather station lost", "P", "RPS", T, (Knob("tracker.no_weather"),)),
    Fault(38, "no distance after a break", "I", "RPS", T, (Knob("tracker.no_distance", count=2),)),
    Fault(
        39,
        "target moves or vibrates",
        "R, then P",
        "RPS",
        T,
        (Knob("tracker.noisy", 0.2, 2), Knob("tracker.noisy", 0.2)),
    ),
    Fault(40, "stale tracker reading", "R", "-RPS", T, (Knob("tracker.late_result", count=1),)),
    Fault(41, "m for mm", "X", "PS", T, (Knob("tracker.metres"),)),
    Fault(42, "left-handed axes", "X", "PS", T, (Knob("tracker.left_handed"),)),
    Fault(
        43,
        "collinear floor nests",
        "X",
        "X",
        C,
        (
            EditedCell(
                'name = "F3", x_mm = 0.0, y_mm = 1500.0', 'name = "F3", x_mm = 3000.0, y_mm = 0.0'
            ),
        ),
        AT_START,
    ),
    Fault(
        44,
        "NaN, inf, 1e308 in a reply",
        "R, then S",
        "RPS",
        (*B, *T),
        (
            Knob("tracker.bad_number", "nan"),
            Knob("tracker.bad_number", "inf"),
            Knob("robot.bad_number", "NaN"),
            Knob("robot.bad_number", "1e308"),
        ),
    ),
    Fault(45, "decimal comma", "X", "S", B, (Knob("robot.bad_number", "1,234"),)),
    Fault(46, "robot E-stop", "S, needs a reset", "S", B, (Knob("robot.e_stop", count=1),)),
    Fault(
        47,
        "robot in T1, or override 0",
        "X",
        "S",
        B,
        (Knob("robot.mode_t1", count=1), Knob("robot.override_zero", count=1)),
    ),
    Fault(48, "wrong configuration or turn", "S, I", "S", B, (Knob("robot.wrong_turn"),)),
    Fault(
        49,
        "wrong tool or base frame",
        "X",
        "S",
        B,
        (Knob("robot.wrong_tool", 2), Knob("robot.wrong_base", 3)),
    ),
    Fault(
        50,
        "robot stops short, stands",
        "S",
        "S",
        B,
        (Knob("robot.stops_short", 1.0), Knob("robot.frozen")),
    ),
    Fault(
        51,
        "robot acknowledges the last command",
        "R, then S",
        "S",
        B,
        (Knob("robot.ack_previous"),),
    ),
    Fault(
        52,
        "server half-dead after a reconnect",
        "R with clean re-open, then P",
        "S",
        B,
        (Knob("robot.half_open"), Knob("robot.restarted")),
    ),
    Fault(53, "vertex unreachable", "skip with mark, P", "S", B, (Knob("robot.softlimit"),)),
    Fault(
        54,
        "robot zero lost",
        "X",
        "PS",
        (*B, *T),
        (Knob("robot.lost_zero", 5.0, 1, lasts=True),),
    ),
    Fault(55, "collision stop", "S", "S", B, (Knob("robot.stopmess", count=1),)),
    Fault(56, "TCP half-open", "R, then S", "S", ANY, _all_wires("blackhole")),
    Fault(57, "RST in mid-reply", "R, then S", "S", ANY, _all_wires("reset")),
    Fault(58, "1-byte slices", "must work", "-", (), _all_wires("slices")),
    Fault(59, "replies glued", "must work", "-", (), _all_wires("glue")),
    Fault(
        60,
        "garbage bytes",
        "R, resync",
        "-RS",
        ANY,
        (
            Knob("rail.garbage", count=2),
            Knob("robot.tag_mismatch", count=1),
            Knob("tracker.length_zero", count=1),
        ),
    ),
    Fault(61, "endless line", "S", "S", ANY, _all_wires("flood")),
    Fault(
        62,
        "serial line unplugged, renumbered",
        "R by its id, then P",
        "S",
        R,
        (),
        only([], "driver's test"),
    ),
    Fault(
        63,
        "slow replies",
        "R, then P",
        "-RPS",
        ANY,
        (Knob("robot.late_reply", 3.0), *_all_wires("slow", 0.02)),
    ),
    Fault(64, "wall clock jumps", "must work", "-", (), (Clock(1.0), Clock(-1.0))),
    Fault(65, "disk full", "P before the next motion, S", "J", C, (FullDisk(),)),
    Fault(66, "kill -9 of the engine", "resume offered", "K", (), (Kill(),)),
    Fault(
        67, "power lost in mid-write", "resume, verified again", "K", (), (Kill(900), Kill(5000))
    ),
    Fault(68, "journal corrupted", "X", "-J", C, (Corrupted(),)),
    Fault(69, "two processes", "X, code 6", "-", (), (SecondEngine(),)),
    Fault(
        70,
        "cell file edited, wrong",
        "X",
        "X",
        C,
        (
            EditedCell("speed_mm_s = 250.0", "speed_mm_s = 150.0"),
            EditedCell("travel_max_mm", "travel_maximum_mm"),
        ),
        AT_START,
    ),
    Fault(
        71,
        "SIGINT twice, SIGTERM, SIGHUP",
        "pause, clean stop, go on",
        "-A",
        (),
        (Signals((SIGINT, SIGINT)), Signals((SIGTERM,)), Signals((SIGHUP,))),
    ),
    Fault(
        72,
        "prompt confirmed, nothing done",
        "P again",
        "P",
        (),
        (NothingDone(),),
        only([MEASURING], "no prompt"),
    ),
)
