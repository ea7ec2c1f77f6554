"""The CiA 402 drive: state machine, moves, homing, faults, and its stop without a master."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import canopen
import pytest

from fakes.canopen.rail_drive import TRANSITIONS, Command, RailDrive, State, command_of
from fakes.faults import Faults
from fakes.truth.rail_truth import RailState, RailTruth
from hilcell.cell.file import load_cell
from tests.fakes.rail_bench import (
    BIT_10,
    BIT_11,
    BIT_12,
    BIT_13,
    MASTER,
    Master,
    served,
    until,
)

WORDS = {
    Command.SHUTDOWN: 0x06,
    Command.SWITCH_ON: 0x07,
    Command.ENABLE_OPERATION: 0x0F,
    Command.DISABLE_VOLTAGE: 0x00,
    Command.QUICK_STOP: 0x02,
    Command.FAULT_RESET: 0x80,
}


@dataclass
class StillRail(RailTruth):
    """A rail that notes its calls and never moves."""

    calls: list[str] = field(default_factory=list)

    def poll(self) -> RailState:
        return RailState(0.0, 0.0, 0.0, False, False, False)

    def move(self, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        self.calls.append(f"move {target_mm} {speed_mm_s} {acceleration_mm_s2}")

    def quick_stop(self, deceleration_mm_s2: float) -> None:
        self.calls.append(f"stop {deceleration_mm_s2}")

    def brake(self, closed: bool) -> None:
        self.calls.append("brake closed" if closed else "brake open")


def alone(state: State = State.SWITCH_ON_DISABLED) -> tuple[RailDrive, StillRail]:
    rail = StillRail()
    drive = RailDrive(rail, Faults(), load_cell("paper").rail, lambda *_: None)
    drive.state = state
    rail.calls.clear()
    return drive, rail


def obey(drive: RailDrive, word: int) -> None:
    drive.dictionary.download(0x6040, 0, word.to_bytes(2, "little"))
    drive.written()


# -- the state machine -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("state", "command"), list(itertools.product(State, Command)), ids=lambda x: x.name
)
def test_whole_matrix_of_states_and_commands(state: State, command: Command) -> None:
    drive, _ = alone(state)
    drive.dictionary.set(0x605A, 0, 6)
    obey(drive, WORDS[command])
    wanted = {
        (State.SWITCH_ON_DISABLED, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,
        (State.READY_TO_SWITCH_ON, Command.SWITCH_ON): State.SWITCHED_ON,
        (State.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION): State.OPERATION_ENABLED,
        (State.READY_TO_SWITCH_ON, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,
        (State.READY_TO_SWITCH_ON, Command.QUICK_STOP): State.SWITCH_ON_DISABLED,
        (State.SWITCHED_ON, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,
        (State.SWITCHED_ON, Command.ENABLE_OPERATION): State.OPERATION_ENABLED,
        (State.SWITCHED_ON, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,
        (State.SWITCHED_ON, Command.QUICK_STOP): State.SWITCH_ON_DISABLED,
        (State.OPERATION_ENABLED, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,
        (State.OPERATION_ENABLED, Command.SWITCH_ON): State.SWITCHED_ON,
        (State.OPERATION_ENABLED, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,
        (State.OPERATION_ENABLED, Command.QUICK_STOP): State.QUICK_STOP_ACTIVE,
        (State.QUICK_STOP_ACTIVE, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,
        (State.QUICK_STOP_ACTIVE, Command.ENABLE_OPERATION): State.OPERATION_ENABLED,
        (State.FAULT, Command.FAULT_RESET): State.SWITCH_ON_DISABLED,
    }
    if command is Command.FAULT_RESET and state is not State.FAULT:
        command = Command.DISABLE_VOLTAGE  # what 0x0080 says to a drive without a fault
    assert drive.state is wanted.get((state, command), state)


def test_table_is_deterministic() -> None:
    edges = [(source, command) for _, source, command, _ in TRANSITIONS]
    assert len(set(edges)) == len(edges)


def test_bits_of_the_controlword() -> None:
    for command, word in WORDS.items():
        if command is not Command.FAULT_RESET:
            assert command_of(word) is command
            assert command_of(word | 0x170) is command, "operation bits change nothing"


def test_fault_is_reset_by_the_edge_only() -> None:
    drive, _ = alone()
    obey(drive, 0x80)
    drive.fail(0x2310)
    states = []
    for word in (0x80, 0x00, 0x80):
        obey(drive, word)
        states.append(drive.state)
    assert states == [State.FAULT, State.FAULT, State.SWITCH_ON_DISABLED]
    assert drive.dictionary.number(0x603F) == 0x2310


@pytest.mark.parametrize("state", [s for s in State if s is not State.OPERATION_ENABLED])
def test_no_set_point_outside_operation_enabled(state: State) -> None:
    drive, rail = alone(state)
    obey(drive, 0x10)
    assert not any(call.startswith("move") for call in rail.calls)


@pytest.mark.parametrize("word", [0x00, 0x02, 0x06, 0x07])
def test_brake_closes_on_leaving_operation_enabled(word: int) -> None:
    drive, rail = alone(State.SWITCHED_ON)
    obey(drive, 0x0F)
    assert rail.calls == ["brake open"]
    obey(drive, word)
    assert rail.calls[-1] == "brake closed"


def in_motion(**objects: int) -> tuple[RailDrive, StillRail]:
    """Return a drive under way to 5 mm; ``objects`` such as ``x605A`` are set before."""
    drive, rail = alone(State.SWITCHED_ON)
    drive.dictionary.download(0x6060, 0, b"\x01")
    for name, value in objects.items():
        drive.dictionary.set(int(name[1:], 16), 0, value)
    drive.dictionary.set(0x607A, 0, 5000)
    obey(drive, 0x0F)
    obey(drive, 0x1F)
    return drive, rail


def test_profile_of_a_move() -> None:
    _, rail = in_motion(x6081=90_000, x607F=80_000, x6083=70_000, x6084=60_000)
    assert rail.calls == ["brake open", "move 5.0 80.0 60.0"]


@pytest.mark.parametrize(
    ("option", "call", "state"),
    [
        (0, "brake closed", State.SWITCH_ON_DISABLED),
        (1, "stop 60.0", State.QUICK_STOP_ACTIVE),
        (2, "stop 50.0", State.QUICK_STOP_ACTIVE),
        (5, "stop 60.0", State.QUICK_STOP_ACTIVE),
        (6, "stop 50.0", State.QUICK_STOP_ACTIVE),
    ],
)
def test_quick_stop_options(option: int, call: str, state: State) -> None:
    drive, rail = in_motion(x605A=option, x6084=60_000, x6085=50_000)
    obey(drive, 0x02)
    assert (rail.calls[2], drive.state) == (call, state)


def test_no_way_back_from_a_quick_stop_that_ends_disabled() -> None:
    drive, rail = in_motion(x605A=2)
    obey(drive, 0x02)
    obey(drive, 0x0F)
    kept = drive.state
    drive.observe(rail.poll())
    assert (kept, drive.state) == (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)
    assert rail.calls[-1] == "brake closed"


def test_set_point_during_halt_is_not_taken() -> None:
    drive, rail = alone(State.SWITCHED_ON)
    drive.dictionary.download(0x6060, 0, b"\x01")
    obey(drive, 0x0F)
    obey(drive, 0x11F)
    assert rail.calls == ["brake open"]


@pytest.mark.parametrize("command", [b"\x02\x00", b"\x82\x05"])
def test_leaving_the_network_in_motion_counts_as_a_lost_connection(command: bytes) -> None:
    drive, _ = in_motion(x6007=3)
    drive.boot(0.0)
    drive.receive(0x000, command, 0.0)
    assert drive.state is State.QUICK_STOP_ACTIVE


def test_both_objects_of_a_frame_are_in_place_before_the_set_point() -> None:
    """RPDO 6040 + 607A: the controlword stands first, the target still belongs to it."""
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        master.write(0x1400, 1, 0xC0000205, "I")
        master.write(0x1600, 0, 0, "B")
        for sub, entry in enumerate((0x60400010, 0x607A0020), start=1):
            master.write(0x1600, sub, entry, "I")
        master.write(0x1600, 0, 2, "B")
        master.write(0x1400, 1, 0x40000205, "I")
        master.network.nmt.send_command(1)
        master.network.send_message(0x205, bytes.fromhex("1F00") + (5000).to_bytes(4, "little"))
        until(master.arrived, "arrived")
        assert master.read(0x6064, 0, "i") == 5000


# -- moves and homing --------------------------------------------------------------------------


def test_homing_then_moves() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        assert master.read(0x6064, 0, "i") == 0
        assert master.read(0x60FD) == 0
        master.move(300_000)
        assert master.read(0x6064, 0, "i") == 300_000
        strip_mm = master.read(0x6004, 0, "i", 6) / 100.0
        assert abs(strip_mm - bench.rail.slide_mm()) < 0.02


def test_never_homed_is_not_shown_as_homed() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.enable(1)
        master.move(1000)
        master.write(0x6060, 0, 6, "b")
        assert not master.status() & BIT_12


def test_homing_without_its_method_is_an_error() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.enable(6)
        with pytest.raises(canopen.SdoAbortedError, match="0x06090030"):
            master.write(0x6098, 0, 35, "b")
        master.control(0x1F)
        assert master.status() & (BIT_13 | BIT_12) == BIT_13


def test_acknowledge_follows_the_set_point_bit() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.enable(1)
        master.start(2000)
        assert master.status() & BIT_12
        master.control(0x0F)
        assert not master.status() & BIT_12


def test_second_set_point_waits_unless_it_says_at_once() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        master.start(200_000)
        master.start(100_000)
        master.control(0x0F)
        assert master.status() & BIT_12, "held back: no room for a third"
        until(lambda: not master.status() & BIT_12, "second set-point taken")
        until(master.arrived, "arrived")
        assert master.read(0x6064, 0, "i") == 100_000
        master.start(200_000)
        master.write(0x607A, 0, 50_000, "i")
        master.control(0x0F)
        master.control(0x3F)
        until(master.arrived, "arrived")
        assert master.read(0x6064, 0, "i") == 50_000


def test_relative_set_point() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        master.move(10_000)
        master.write(0x607A, 0, -2500, "i")
        master.control(0x5F)
        until(master.arrived, "arrived")
        assert master.read(0x6064, 0, "i") == 7500
        master.start(900_000)
        assert not master.slow()
        master.control(0x02)
        until(lambda: master.status() & 0x4F == 0x40, "stopped")
        stopped = master.read(0x6064, 0, "i")
        master.enable(1)
        master.write(0x607A, 0, 1000, "i")
        master.control(0x5F)
        until(master.arrived, "arrived")
        assert abs(master.read(0x6064, 0, "i") - stopped - 1000) <= 1, "from where it stands"


def test_halt_and_on() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        master.start(500_000)
        master.control(0x10F)
        until(master.slow, "halted")
        assert master.read(0x6064, 0, "i") < 500_000
        master.control(0x0F)
        until(lambda: master.read(0x6064, 0, "i") == 500_000, "went on")


def test_halt_of_nothing_starts_nothing() -> None:
    drive, rail = alone(State.SWITCHED_ON)
    drive.dictionary.download(0x6060, 0, b"\x01")
    for word in (0x0F, 0x10F, 0x0F):
        obey(drive, word)
    assert rail.calls == ["brake open"]


def test_software_limit_holds_the_target_back() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        master.write(0x607D, 2, 20_000, "i")
        master.move(30_000)
        assert master.status() & BIT_11
        assert master.read(0x6064, 0, "i") == 20_000


def test_mode_cannot_change_in_motion() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.enable(1)
        master.start(500_000)
        with pytest.raises(canopen.SdoAbortedError, match="0x08000022"):
            master.write(0x6060, 0, 6, "b")


def test_real_limit_switch_is_a_fault() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        master.start(-5000)
        until(lambda: master.status() & 0x4F == 0x08, "fault")
        assert master.status() & BIT_11
        assert master.read(0x603F, 0, "H") == 0x8612
        assert master.read(0x60FD) == 1
        master.control(0x80)
        master.enable(1)
        master.move(5000)
        assert master.read(0x6064, 0, "i") == 5000, "away from the switch it may go"
        assert not master.status() & BIT_11


# -- stops -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("option", "ends"), [(2, 0x40), (6, 0x07)])
def test_quick_stop_by_receive_pdo(option: int, ends: int) -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        master.write(0x605A, 0, option, "h")
        master.network.nmt.send_command(1)
        master.start(1_000_000)
        master.network.send_message(0x205, b"\x02\x00")
        until(master.slow, "stopped")
        assert master.status() & 0x4F == ends & 0x4F
        assert bench.rail.still
        assert master.read(0x6064, 0, "i") < 1_000_000
        if option == 6:
            assert master.status() & BIT_10
            master.control(0x0F)
            assert master.status() & 0x6F == 0x27


@pytest.mark.parametrize("option", [0, 1, 2, 3])
def test_lost_heartbeat_stops_a_moving_slide(option: int) -> None:
    """Paced time: the drive stops by itself, as 6007 says, when the master falls silent."""
    with served(20.0) as bench, Master(bench.server.port) as master:
        master.home()
        master.write(0x6007, 0, option, "h")
        master.write(0x6081, 0, 20_000, "I")
        master.write(0x1016, 1, MASTER << 16 | 100, "I")
        master.network.nmt.send_command(1)
        beats = master.start_heartbeat(0.02)
        master.start(3_000_000)
        until(lambda: master.read(0x6064, 0, "i") > 1000, "under way")
        beats.stop()
        until(lambda: bool(master.drive.emcy.active), "EMCY")
        assert master.drive.emcy.log[0].code == 0x8130
        if option == 0:
            assert master.status() & 0x6F == 0x27
            assert not bench.rail.still
            return
        until(lambda: bench.rail.still, "stands")
        stopped = {1: 0x08, 2: 0x40, 3: 0x40}[option]
        until(lambda: master.status() & 0x4F == stopped, "brake closed")


@pytest.mark.parametrize("speed", [20.0, float("inf")])
def test_vanished_client_stops_the_slide_and_the_next_one_works_at_once(speed: float) -> None:
    with served(speed) as bench:
        with Master(bench.server.port) as master:
            master.home()
            master.write(0x6007, 0, 3, "h")
            master.write(0x6081, 0, 20_000, "I")
            master.write(0x1016, 1, MASTER << 16 | 100, "I")
            beats = master.start_heartbeat(0.02)
            until(lambda: master.read(0x1001, 0, "B") == 0, "heard")
            master.start(2_900_000)
            assert not master.slow()
            beats.stop()
        until(lambda: bench.rail.still, "stands")
        with Master(bench.server.port) as master:
            assert master.status() & 0x6F == 0x40
            position = master.read(0x6064, 0, "i")
            assert 0 < position < 2_900_000, "the drive kept its reference"
            assert master.read(0x6007, 0, "h") == 3
            master.enable(1)
            master.move(position + 1000)


# -- canopen's own CiA 402 node as the peer ----------------------------------------------------


def test_base_node_402_enables_moves_homes_and_resets() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.write(0x1017, 0, 20, "H")
        master.write(0x1800, 5, 10, "H")  # canopen waits for TPDOs that come regularly
        master.drive.nmt.wait_for_heartbeat(5.0)
        master.drive.setup_402_state_machine()
        master.drive.nmt.state = "OPERATIONAL"
        until(lambda: master.drive.state == "SWITCH ON DISABLED", "statusword by TPDO")
        master.write(0x6098, 0, 17, "b")
        assert master.drive.homing(timeout=5.0)
        master.drive.op_mode = "PROFILED POSITION"
        assert master.read(0x6061, 0, "b") == 1
        master.write(0x607A, 0, 12_345, "i")
        master.drive.controlword = 0x0F
        master.drive.controlword = 0x1F
        until(master.arrived, "arrived")
        assert master.read(0x6064, 0, "i") == 12_345
        bench.faults.set("rail.fault", 0x2310)
        master.write(0x607A, 0, 900_000, "i")
        master.drive.controlword = 0x0F
        master.drive.controlword = 0x1F
        until(lambda: master.status() & 0x4F == 0x08, "fault")
        until(lambda: master.drive.state == "FAULT", "fault by TPDO")
        master.drive.controlword = 0x80
        until(lambda: master.drive.state == "SWITCH ON DISABLED", "reset by the edge")
        assert [entry.code for entry in master.drive.emcy.log] == [0x2310, 0]
