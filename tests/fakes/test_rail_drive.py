"""The CiA 402 drive: state machine, moves, homing, faults, and its stop without a master."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import pytest

from fakes.canopen.rail_device import RailDevice
from fakes.canopen.rail_server import Command, RailDrive, State
from fakes.faults import Faults
from fakes.truth.rail_truth import RailState, RailTruth
from tests.fakes.rail_bench import (
    BIT_10,
    BIT_11,
    BIT_12,
    BIT_13,
    CELL,
    MASTER,
    PATIENT_S,
    Bus,
    Master,
    SdoAbort,
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
    drive = RailDrive(rail, Faults(), CELL.rail, lambda *_: None, RailDevice())
    drive.state = state
    rail.calls.clear()
    return drive, rail


def obey(drive: RailDrive, word: int) -> None:
    drive.dictionary.entry(0x6040, 0).download(word.to_bytes(2, "little"))
    drive.written()


# -- the state machine -------------------------------------------------------------------------


def test_whole_matrix_of_states_and_commands() -> None:
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
    for state, command in itertools.product(State, Command):
        drive, _ = alone(state)
        drive.dictionary.set(0x605A, 0, 6)
        obey(drive, WORDS[command])
        said = command
        if command is Command.FAULT_RESET and state is not State.FAULT:
            said = Command.DISABLE_VOLTAGE  # what 0x0080 says to a drive without a fault
        assert drive.state is wanted.get((state, said), state), (state, command)


def test_bits_of_the_controlword() -> None:
    for command, word in WORDS.items():
        if command is not Command.FAULT_RESET:
            assert Command.of(word) is command
            assert Command.of(word | 0x170) is command, "operation bits change nothing"


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


def test_no_set_point_outside_operation_enabled() -> None:
    for state in set(State) - {State.OPERATION_ENABLED}:
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
    drive.dictionary.entry(0x6060, 0).download(b"\x01")
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


@pytest.mark.parametrize("words", [(0x0F, 0x11F), (0x0F, 0x10F, 0x0F)])
def test_a_halt_starts_nothing(words: tuple[int, ...]) -> None:
    """A set-point during it is not taken."""
    drive, rail = alone(State.SWITCHED_ON)
    drive.dictionary.entry(0x6060, 0).download(b"\x01")
    for word in words:
        obey(drive, word)
    assert rail.calls == ["brake open"]


@pytest.mark.parametrize("command", [b"\x02\x00", b"\x82\x05"])
def test_leaving_the_network_in_motion_counts_as_a_lost_connection(command: bytes) -> None:
    drive, _ = in_motion(x6007=3)
    drive.boot(0.0)
    drive.receive(0x000, command, 0.0)
    assert drive.state is State.QUICK_STOP_ACTIVE


def test_both_objects_of_a_frame_are_in_place_before_the_set_point(bus: Bus) -> None:
    """RPDO 6040 + 607A: the controlword stands first, the target still belongs to it."""
    bus.home()
    bus.write(0x1400, 1, 0xC0000205, "I")
    bus.write(0x1600, 0, 0, "B")
    for sub, entry in enumerate((0x60400010, 0x607A0020), start=1):
        bus.write(0x1600, sub, entry, "I")
    bus.write(0x1600, 0, 2, "B")
    bus.write(0x1400, 1, 0x40000205, "I")
    bus.start_nodes()
    bus.send(0x205, bytes.fromhex("1F00") + (5000).to_bytes(4, "little"))
    until(bus.arrived)
    assert bus.position() == 5000


# -- moves and homing --------------------------------------------------------------------------


def test_homing_then_moves(bus: Bus) -> None:
    bus.home()
    assert bus.position() == 0
    assert bus.read(0x60FD) == 0
    bus.move(300_000)
    assert bus.position() == 300_000
    strip_mm = bus.read(0x6004, 0, "i", 6) / 100.0
    assert abs(strip_mm - bus.rail.slide_mm()) < 0.02


def test_never_homed_is_not_shown_as_homed(bus: Bus) -> None:
    bus.enable(1)
    bus.move(1000)
    bus.write(0x6060, 0, 6, "b")
    assert not bus.status() & BIT_12


def test_homing_without_its_method_is_an_error(bus: Bus) -> None:
    bus.enable(6)
    with pytest.raises(SdoAbort) as refused:
        bus.write(0x6098, 0, 35, "b")
    assert refused.value.code == 0x06090030
    bus.control(0x1F)
    assert bus.status() & (BIT_13 | BIT_12) == BIT_13


def test_second_set_point_waits_unless_it_says_at_once(bus: Bus) -> None:
    bus.home()
    bus.start(200_000)
    bus.start(100_000)
    bus.control(0x0F)
    assert bus.status() & BIT_12, "held back: no room for a third"
    until(lambda: not bus.status() & BIT_12)
    until(bus.arrived)
    assert bus.position() == 100_000
    bus.start(200_000)
    bus.write(0x607A, 0, 50_000, "i")
    bus.control(0x0F)
    assert not bus.status() & BIT_12, "the acknowledge follows the set-point bit"
    bus.control(0x3F)
    until(bus.arrived)
    assert bus.position() == 50_000


def test_relative_set_point(bus: Bus) -> None:
    bus.home()
    bus.move(10_000)
    bus.write(0x607A, 0, -2500, "i")
    bus.control(0x5F)
    until(bus.arrived)
    assert bus.position() == 7500
    bus.start(900_000)
    assert not bus.slow()
    bus.control(0x02)
    until(lambda: bus.status() & 0x4F == 0x40)
    stopped = bus.position()
    bus.enable(1)
    bus.write(0x607A, 0, 1000, "i")
    bus.control(0x5F)
    until(bus.arrived)
    assert abs(bus.position() - stopped - 1000) <= 1, "from where it stands"


def test_halt_and_on(bus: Bus) -> None:
    bus.home()
    bus.start(500_000)
    bus.control(0x10F)
    until(bus.slow)
    assert bus.position() < 500_000
    bus.control(0x0F)
    until(lambda: bus.position() == 500_000)


def test_software_limit_holds_the_target_back(bus: Bus) -> None:
    bus.home()
    bus.write(0x607D, 2, 20_000, "i")
    bus.move(30_000)
    assert bus.status() & BIT_11
    assert bus.position() == 20_000


def test_mode_cannot_change_in_motion(bus: Bus) -> None:
    bus.enable(1)
    bus.start(500_000)
    with pytest.raises(SdoAbort) as refused:
        bus.write(0x6060, 0, 6, "b")
    assert refused.value.code == 0x08000022


def test_real_limit_switch_is_a_fault(bus: Bus) -> None:
    bus.home()
    bus.start(-5000)
    until(bus.faulty)
    assert bus.status() & BIT_11
    assert bus.read(0x603F, 0, "H") == 0x8612
    assert bus.read(0x60FD) == 1
    bus.control(0x80)
    bus.enable(1)
    bus.move(5000)
    assert bus.position() == 5000, "away from the switch it may go"
    assert not bus.status() & BIT_11


# -- stops -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("option", "ends"), [(2, 0x40), (6, 0x07)])
def test_quick_stop_by_receive_pdo(bus: Bus, option: int, ends: int) -> None:
    bus.home()
    bus.write(0x605A, 0, option, "h")
    bus.start_nodes()
    bus.start(1_000_000)
    bus.send(0x205, b"\x02\x00")
    until(bus.slow)
    assert bus.status() & 0x4F == ends & 0x4F
    assert bus.rail.at_rest
    assert bus.position() < 1_000_000
    if option == 6:
        assert bus.status() & BIT_10
        bus.control(0x0F)
        assert bus.status() & 0x6F == 0x27


def left_alone(bus: Bus, option: int) -> None:
    """Start a long motion, and give no heartbeat for twice as long as the drive waits for one."""
    bus.home()
    bus.write(0x6007, 0, option, "h")
    bus.write(0x1016, 1, MASTER << 16 | 100, "I")
    bus.start_nodes()
    bus.beat()
    bus.start(2_900_000)
    assert not bus.slow()
    bus.let_pass(0.09)
    bus.beat()
    bus.let_pass(0.09)
    assert bus.emergencies() == []
    assert not bus.rail.at_rest
    bus.let_pass(0.2)
    assert bus.emergencies() == [0x8130]


@pytest.mark.parametrize(("option", "stopped"), [(1, 0x08), (2, 0x40), (3, 0x40)])
def test_lost_heartbeat_stops_a_moving_slide(bus: Bus, option: int, stopped: int) -> None:
    """The drive stops by itself, as 6007 says, when the master falls silent."""
    left_alone(bus, option)
    assert bus.rail.at_rest
    assert bus.status() & 0x4F == stopped
    position = bus.position()
    assert 0 < position < 2_900_000, "the drive kept its reference"
    assert bus.read(0x6007, 0, "h") == option
    if option == 3:
        bus.enable(1)
        bus.move(position + 1000)


def test_lost_heartbeat_may_stop_nothing(bus: Bus) -> None:
    left_alone(bus, 0)
    assert bus.status() & 0x6F == 0x27
    assert not bus.rail.at_rest


# -- canopen's own CiA 402 node as the peer ----------------------------------------------------


def test_base_node_402_enables_moves_homes_and_resets() -> None:
    with served() as bench, Master(bench.server.port) as master:
        for name in vars(type(master.drive)):
            if name.startswith("TIMEOUT_"):
                setattr(master.drive, name, PATIENT_S)
        master.write(0x1017, 0, 20, "H")
        master.write(0x1800, 5, 10, "H")  # canopen waits for TPDOs that come regularly
        master.drive.nmt.wait_for_heartbeat(PATIENT_S)
        master.drive.setup_402_state_machine()
        master.drive.nmt.state = "OPERATIONAL"
        until(lambda: master.drive.state == "SWITCH ON DISABLED")
        master.write(0x6098, 0, 17, "b")
        assert master.drive.homing(timeout=PATIENT_S)
        master.drive.op_mode = "PROFILED POSITION"
        assert master.read(0x6061, 0, "b") == 1
        master.write(0x607A, 0, 12_345, "i")
        master.drive.controlword = 0x0F
        master.drive.controlword = 0x1F
        until(master.arrived)
        assert master.position() == 12_345
        bench.faults.set("rail.fault", 0x2310)
        master.write(0x607A, 0, 900_000, "i")
        master.drive.controlword = 0x0F
        master.drive.controlword = 0x1F
        until(master.faulty)
        until(lambda: master.drive.state == "FAULT")
        master.drive.controlword = 0x80
        until(lambda: master.drive.state == "SWITCH ON DISABLED")
        assert [entry.code for entry in master.drive.emcy.log] == [0x2310, 0]
