"""The faults of a controller of ABB, as `campaigns.faults.table` has those of cell paper.

The position stream of its fake always loses, doubles and delays datagrams: each case runs so.
"""

from __future__ import annotations

from campaigns.faults.injections import Kill, Knob, Wire
from campaigns.faults.phases import Phase
from campaigns.faults.table import MEASURING, ROBOT, B, Fault, only

WHILE_IT_RUNS = only([Phase.RAIL, ROBOT, MEASURING, Phase.PAUSED, Phase.TEARDOWN], "no stream")
# The stop that such a controller takes late ends the program of the next session, too.
LATE = Knob("robot.late_reply", 3.0, lasts=True)

FAULTS_OF_ABB = (
    Fault(1, "mastership taken by the pendant", "S", "S", B, (Knob("robot.mastership_taken"),)),
    Fault(2, "program stopped at the pendant", "S", "S", B, (Knob("robot.deselected", count=1),)),
    Fault(3, "motors off", "S", "S", B, (Knob("robot.motors_off", count=1),)),
    Fault(4, "emergency stop", "S", "S", B, (Knob("robot.e_stop", count=1),)),
    Fault(5, "automatic to manual", "S", "S", B, (Knob("robot.mode_t1", count=1),)),
    Fault(
        6,
        "speed lowered at the pendant",
        "S",
        "S",
        B,
        (Knob("robot.speed_ratio", 3.0, 1), Knob("robot.override_zero", count=1)),
    ),
    Fault(
        7,
        "error of the controller",
        "S",
        "S",
        B,
        (Knob("robot.stopmess", count=1), Knob("robot.softlimit")),
    ),
    Fault(8, "controller restarted", "S", "S", B, (Knob("robot.restarted", count=1),)),
    Fault(
        9,
        "stream silent",
        "S",
        "S",
        B,
        (Knob("robot.stream_silent", 3.0, wait_s=1.0),),
        WHILE_IT_RUNS,
    ),
    Fault(10, "controller's time stands", "S", "S", B, (Knob("robot.stream_time"),)),
    Fault(11, "two streams", "S", "S", B, (Knob("robot.second_stream"),)),
    Fault(12, "wrong tool", "S", "S", B, (Knob("robot.wrong_tool"),)),
    Fault(
        13,
        "position that is no number",
        "S",
        "S",
        B,
        (Knob("robot.bad_number", "nan"), Knob("robot.bad_number", "1e308")),
    ),
    Fault(
        14,
        "motion stops short, stands, or ends elsewhere",
        "S",
        "S",
        B,
        (Knob("robot.stops_short", 1.0), Knob("robot.frozen"), Knob("robot.wrong_turn")),
    ),
    Fault(
        15,
        "web services silent or closed",
        "S",
        "S",
        B,
        (Knob("robot.no_reply"), Knob("robot.half_open"), LATE),
    ),
    Fault(
        16,
        "network before the web services",
        "S",
        "S",
        B,
        (Wire("robot", "blackhole"), Wire("robot", "flood")),
    ),
    # A connection that is closed while nothing is asked is opened again.
    Fault(17, "connection reset", "S in mid-answer", "-S", B, (Wire("robot", "reset"),)),
    Fault(
        18,
        "slices, glued or slow answers",
        "must work",
        "-",
        (),
        (Wire("robot", "slices"), Wire("robot", "glue"), Wire("robot", "slow", 0.02)),
    ),
    Fault(19, "kill -9 of the engine", "resume offered", "K", (), (Kill(),)),
)
