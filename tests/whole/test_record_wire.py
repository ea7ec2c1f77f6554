"""A recorded wire is a device: a run repeats from its recording alone.

`tests/wires` keeps a recording of each driver with its simulated device, and what the recorded run
has journalled. A driver that asks otherwise than before, or another form of the files, needs new
ones: `make recordings`.
"""

from __future__ import annotations

import json
import lzma
import os
import pty
import re
import shutil
import socket
import tempfile
import tty
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.metadata import entry_points
from pathlib import Path

import msgspec
import pytest

from drivers import strips
from drivers.canopen import process_image, sdo
from fakes.replay.dialects import Dialect, dialects_of
from fakes.replay.player import EventTime, Exchange, Script, exchanges, landmarks
from hilcell.cell.devices import check_options, placeholder_addresses
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.journal.runs import read_log
from hilcell.wire.channel import SerialLine, Socket
from hilcell.wire.recording import (
    PACKED,
    SUFFIX,
    Piece,
    Recorder,
    RunHeader,
    WireRecording,
    read_recording,
    recordings,
)
from hilcell.wire.relay import SerialRelay, SocketRelay
from tests.whole.bench import command, sets
from tests.whole.recordings import (
    FACTS,
    KEPT,
    PAIRS,
    SMALL,
    STRIP,
    curves,
    facts,
    joints_deg,
    places_mm,
    played,
    procedure,
    record,
)

pytestmark = pytest.mark.waits
RESULT = bytes.fromhex("9c000000 02000000")
HEAD = RunHeader("r1", "home", 1, 1, msgspec.to_builtins(load_cell("paper")))
PLACE_MM = 0.02  # a busy PC polls more often, and so takes medians of others
CURVE = 0.1  # cycles, urad and ms
JOINT_DEG = 0.002  # a robot of Universal Robots dithers, and any of its states may be read


def repeat(pair: str, recording: Path, runs: Path) -> tuple[int, Path]:
    """Run again with a recording in place of the devices; return exit code and folder."""
    wanted: list[str | Path] = [*PAIRS[pair], *sets(SMALL | played(recording))]
    wanted += ["--unattended", "--runs", runs, "--name", "again"]
    return command("run", procedure(pair), *wanted).returncode, runs / "again"


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Never ask a drive or a strip twice because a busy PC was late: it shows another place."""
    for module in (process_image, sdo, strips.SerialStrip):
        monkeypatch.setattr(module, "REPLY_S", 30.0)


@pytest.mark.process
@pytest.mark.usefixtures("patient")
def test_a_run_is_recorded_and_repeats_from_its_recording_alone(tmp_path: Path) -> None:
    pair = "kuka-c3,leica-emscon,canopen"
    first = record(pair, tmp_path, "first")
    code, again = repeat(pair, first, tmp_path)
    assert code == 0
    assert facts(again) == facts(first)
    assert joints_deg(again) == joints_deg(first) != []


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("pair", PAIRS)
def test_a_kept_recording_repeats(pair: str, tmp_path: Path) -> None:
    code, again = repeat(pair, KEPT / pair, tmp_path)
    assert code == 0, read_log(again).end
    kept = json.loads((KEPT / pair / FACTS).read_bytes())
    assert facts(again) == kept["facts"]
    assert joints_deg(again) == pytest.approx(kept["joints_deg"], abs=JOINT_DEG)
    assert places_mm(again) == pytest.approx(kept["places_mm"], abs=PLACE_MM)
    assert curves(again) == pytest.approx(kept["curves"], abs=CURVE)


def test_every_shipped_driver_has_a_kept_recording() -> None:
    named = [each for pair in PAIRS for each in pair.split(",")]
    kept = {each.removesuffix("-strip").removesuffix("-swept") for each in named}
    shipped = set().union(*(names_of(group) for group in ("robots", "trackers", "rails")))
    by_udp = {"abb-egm"}  # its positions are in no recording
    assert kept == shipped - by_udp
    assert {path.name for path in KEPT.iterdir()} == set(PAIRS)
    assert sum(path.stat().st_size for path in KEPT.rglob("*") if path.is_file()) < 600_000


def names_of(group: str) -> set[str]:
    """Return the drivers of this package that have a wire."""
    entries = entry_points(group=f"hilcell.{group}")
    return {each.name for each in entries if each.value.startswith("drivers.")} - {"none"}


def with_one_byte_changed(
    kept: Path, folder: Path, wire: str, change: Callable[[bytes], bytes | None]
) -> Path:
    """Copy a recording in which the last answer that ``change`` wants is another one."""
    folder.mkdir()
    for name, path in recordings(kept).items():
        pieces, changed = read_recording(path), name != wire
        for n, piece in reversed(list(enumerate(pieces))):
            if not changed and piece.e == "<" and (data := change(piece.data)) is not None:
                pieces[n], changed = Piece.of(piece.t, piece.c, "<", data), True
        assert changed
        lines = [msgspec.json.encode(piece) + b"\n" for piece in pieces]
        (folder / f"{name}{SUFFIX}").write_bytes(b"".join(lines))
    return folder


def last_digit(number: bytes) -> Callable[[bytes], bytes | None]:
    """Return a change of the last digit of a number."""
    other = number[:-1] + (b"1" if number[-1:] != b"1" else b"2")
    return lambda data: data.replace(number, other) if number in data else None


def result(data: bytes) -> bytes | None:
    """Change the last bit of a coordinate of an emScon tracker's result."""
    at = data.find(RESULT) + 20
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :] if 20 <= at < len(data) else None


def distance(data: bytes) -> bytes | None:
    """Change a digit of a total station's distance."""
    line = re.fullmatch(rb"(%R1P,0,\d+:0,[\d.]+,[\d.]+,\d+\.\d\d)(\d)(.*\r\n)", data)
    return None if line is None else line[1] + (b"1" if line[2] != b"1" else b"2") + line[3]


def coordinate(data: bytes) -> bytes | None:
    """Change a digit of a coordinate that SpatialAnalyzer's bridge has measured."""
    line = re.fullmatch(rb"(ACK-300 Single .* result -?\d+\.\d)(\d)(.*\r\n)", data)
    return None if line is None else line[1] + (b"1" if line[2] != b"1" else b"2") + line[3]


CHANGES = [
    ("kuka-c3,t2sa,canopen", "tracker", coordinate),
    ("kuka-c3,leica-emscon,canopen", "tracker", result),
    ("kuka-c3,leica-emscon,kuka-e1", "rail.strip", last_digit(b"2014003")),
    ("kuka-eki,leica-geocom,kuka-e1", "tracker", distance),
    ("ur-rtde,leica-geocom,canopen-strip", "robot.dashboard", last_digit(b"20225500147")),
]


@pytest.mark.parametrize(("pair", "wire", "change"), CHANGES)
def test_another_byte_on_a_wire_is_another_run(
    pair: str, wire: str, change: Callable[[bytes], bytes | None], tmp_path: Path
) -> None:
    other = with_one_byte_changed(KEPT / pair, tmp_path / "other", wire, change)
    code, again = repeat(pair, other, tmp_path)
    kept = json.loads((KEPT / pair / FACTS).read_bytes())
    assert code != 0 or facts(again) != kept["facts"]


@pytest.mark.process
def test_a_recording_of_another_driver_is_refused_with_its_name(tmp_path: Path) -> None:
    folder = tmp_path / "r1"
    folder.mkdir()
    cell = load_cell("paper")
    WireRecording(cell, placeholder_addresses(cell), folder, HEAD).close()
    drivers = played(folder)
    check_options(load_cell("paper", drivers))
    cell = load_cell("paper", drivers | {"tracker.driver": "leica-geocom"})
    wanted = "with driver 'leica-emscon', here it is 'leica-geocom'; add --set tracker.driver=leica"
    with pytest.raises(SettingsError, match=wanted):
        check_options(cell)
    with pytest.raises(SettingsError, match="'mine' is not installed"):
        check_options(load_cell("paper", drivers | {"robot.driver": "mine"}))


@pytest.mark.parametrize("wire", ["robot", "robot.stop", "rail.strip", "tracker"])
def test_a_wire_without_a_recording_never_reaches_the_device(wire: str, tmp_path: Path) -> None:
    """A replay without one file spoke to what stands at the address in the cell file."""
    pair, folder = "kuka-eki,leica-geocom,kuka-e1", tmp_path / "folder"
    shutil.copytree(KEPT / pair, folder)
    (folder / f"{wire}{SUFFIX}{PACKED}").unlink()
    address = ["--set", "tracker.options.channel=socket://127.0.0.1:1"]
    done = command("run", "home", *PAIRS[pair], *address, *sets(played(folder)))
    assert done.returncode == 2
    assert f"{folder}: no {wire}{SUFFIX}; use the whole folder" in done.stderr


# -- the relay -------------------------------------------------------------------------------------


@pytest.fixture
def kept(tmp_path: Path) -> Iterator[tuple[Recorder, Path]]:
    path = tmp_path / f"robot{SUFFIX}"
    with path.open("ab") as file:
        recorder = Recorder(file, 0.0)
        yield recorder, path
        recorder.close()


def recorded_until(path: Path, event: str) -> list[Piece]:
    """Return a recording that has come so far; ends by the suite's own time limit."""
    while not path.stat().st_size or (pieces := read_recording(path))[-1].e != event:
        pass
    return pieces


def test_bytes_pass_unchanged_in_both_directions_and_are_recorded(
    kept: tuple[Recorder, Path],
) -> None:
    recorder, path = kept
    with socket.create_server(("127.0.0.1", 0)) as device:
        relay = SocketRelay(Socket("127.0.0.1", device.getsockname()[1]), recorder)
        host, port = relay.channel.removeprefix("socket://").split(":")
        with socket.create_connection((host, int(port))) as driver:
            far, _ = device.accept()
            with far:
                driver.sendall(b"\x00\xffask")
                assert far.recv(100) == b"\x00\xffask"
                far.sendall(b"answer\r\n")
                assert driver.recv(100) == b"answer\r\n"
                far.shutdown(socket.SHUT_RDWR)
                assert driver.recv(100) == b""
    pieces = recorded_until(path, "end")
    relay.close()
    assert [(p.c, p.e, p.data) for p in pieces] == [
        (1, "open", b""), (1, ">", b"\x00\xffask"), (1, "<", b"answer\r\n"), (1, "lost", b""),
        (1, "end", b""),
    ]  # fmt: skip
    times = [piece.t for piece in pieces]
    assert times == sorted(times)


def test_a_relay_that_ends_leaves_no_connection_open(kept: tuple[Recorder, Path]) -> None:
    """A recording without the end of a connection is one that was cut."""
    recorder, path = kept
    with socket.create_server(("127.0.0.1", 0)) as device:
        relay = SocketRelay(Socket("127.0.0.1", device.getsockname()[1]), recorder)
        host, port = relay.channel.removeprefix("socket://").split(":")
        with socket.create_connection((host, int(port))) as driver, device.accept()[0]:
            driver.sendall(b"ask")
            recorded_until(path, ">")
            relay.close()
            assert [piece.e for piece in read_recording(path)] == ["open", ">", "end"]


def test_a_device_that_is_not_there_hangs_up(kept: tuple[Recorder, Path]) -> None:
    recorder, path = kept
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    relay = SocketRelay(Socket("127.0.0.1", port), recorder)
    host, _, listening = relay.channel.removeprefix("socket://").partition(":")
    with socket.create_connection((host, int(listening))) as driver:
        assert driver.recv(1) == b""
    assert recorded_until(path, "refused")[0].e == "refused"
    relay.close()


def test_a_serial_line_passes_through_a_pseudo_terminal(kept: tuple[Recorder, Path]) -> None:
    recorder, path = kept
    device, line = pty.openpty()
    tty.setraw(line)
    relay = SerialRelay(SerialLine(os.ttyname(line)), recorder)
    driver = os.open(relay.channel, os.O_RDWR | os.O_NOCTTY)
    os.write(driver, b"%R1Q,0,1:\r\n")
    assert os.read(device, 100) == b"%R1Q,0,1:\r\n"
    os.write(device, b"%R1P,0,1:0\r\n")
    assert os.read(driver, 100) == b"%R1P,0,1:0\r\n"
    relay.close()
    for file in (driver, device, line):
        os.close(file)
    assert [p.e for p in read_recording(path)][:3] == ["open", ">", "<"]


def test_a_stop_waits_for_a_device_whose_line_is_full(kept: tuple[Recorder, Path]) -> None:
    device, line = pty.openpty()
    tty.setraw(line)
    relay = SerialRelay(SerialLine(os.ttyname(line)), kept[0])
    driver = os.open(relay.channel, os.O_RDWR | os.O_NOCTTY)
    os.set_blocking(line, False)
    waiting = 0
    with suppress(BlockingIOError):
        while True:
            waiting += os.write(line, b"unread")
    os.write(driver, b"stop")
    recorded_until(kept[1], ">")
    os.write(device, b"answer")
    assert os.read(driver, 100) == b"answer"  # so the stop was sent, as far as there is room
    arrived = b""
    while len(arrived) < waiting + len(b"stop"):
        arrived += os.read(device, 4096)
    assert arrived.endswith(b"stop")
    relay.close()
    for file in (driver, device, line):
        os.close(file)


def test_a_serial_line_that_cannot_be_opened_leaves_no_folder(
    kept: tuple[Recorder, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "lines"))
    (tmp_path / "lines").mkdir()
    with pytest.raises(OSError, match="no-such-line"):
        SerialRelay(SerialLine(str(tmp_path / "no-such-line")), kept[0])
    assert list((tmp_path / "lines").iterdir()) == []


@pytest.mark.process
def test_a_can_interface_is_left_out_with_its_reason(tmp_path: Path) -> None:
    cell = load_cell("paper")
    strip = {"driver": "canopen", "interface": "socketcan", "channel": "can1"}
    options = {"interface": "socketcan", "channel": "can0", "strip": strip}
    cell = msgspec.structs.replace(cell, rail=msgspec.structs.replace(cell.rail, options=options))
    recording = WireRecording(cell, {}, tmp_path, HEAD)
    recording.close()
    assert recording.left_out == {
        "rail": "can0 is a CAN interface: record it with `candump -l can0`; "
        "can1 is a CAN interface: record it with `candump -l can1`"
    }
    assert recording.addresses["robot"]["host"] == "127.0.0.1"


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    for name in ("x", f"x{PACKED}"):
        path = tmp_path / name
        path.write_text('{"t": 1.0, "c": 1, "e": "stop"}\n')
        with pytest.raises(SettingsError, match="no recording of a wire"):
            read_recording(path)


@pytest.mark.parametrize("packed", [False, True])
def test_a_changed_byte_is_noticed(packed: bool, tmp_path: Path) -> None:
    path = tmp_path / f"robot{SUFFIX}{PACKED if packed else ''}"
    pieces = [
        Piece.of(0.25, 1, "open"), Piece.of(0.5, 1, ">", b"ask\r"), Piece.of(0.75, 1, "<", b"1\r")
    ]  # fmt: skip
    text = b"".join(msgspec.json.encode(piece) + b"\n" for piece in pieces)
    data = lzma.compress(text) if packed else text
    path.write_bytes(data)
    assert read_recording(path) == pieces
    for at in range(len(data) - 1):  # without the last line's end it is one that was cut off
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with pytest.raises(SettingsError, match="no recording of a wire"):
            read_recording(path)


@pytest.mark.process
def test_a_resumed_run_is_recorded_in_a_folder_of_its_own(tmp_path: Path) -> None:
    cell = load_cell("paper")
    for _ in range(3):
        WireRecording(cell, {}, tmp_path, HEAD).close()
    for folder in (tmp_path, tmp_path / "wires-2", tmp_path / "wires-3"):
        assert set(recordings(folder)) == {"clock", "rail", "robot", "tracker"}


@pytest.mark.process
def test_every_wire_of_a_device_is_recorded(tmp_path: Path) -> None:
    cell = load_cell("lab", {"rail.options.strip": STRIP})
    recording = WireRecording(cell, {}, tmp_path, HEAD)
    recording.close()
    assert set(recordings(tmp_path)) == {
        "clock", "rail", "rail.strip", "robot.rtde", "robot.script", "robot.dashboard", "tracker"
    }  # fmt: skip
    robot, strip = recording.addresses["robot"], recording.addresses["rail"]["strip"]
    ports = {robot[f"{name}_port"] for name in ("rtde", "script", "dashboard")}
    assert robot["host"] == "127.0.0.1"
    assert len(ports) == 3
    assert isinstance(strip, dict)
    assert strip["channel"] != "socket://127.0.0.1:1"
    assert strip["counts_per_mm"] == 100.0


# -- the script ------------------------------------------------------------------------------------


def script_of(found: list[Exchange], dialect: Dialect, *landmarks_s: float) -> Script:
    """Return the script of one connection, with landmarks of its own and of others."""
    time, names = EventTime(), landmarks([found], dialect)
    own_s = [each.time_s for each in found[1:] if dialect.name(each.asked) in names]
    time.expect([], [*own_s, *landmarks_s])
    return Script(found, dialect, time, names)


def polls(count: int) -> list[Exchange]:
    """Return questions asked at 1, 2 .. s, each answered by its number."""
    return [Exchange(b"poll\r", [b"%d\r" % n], n) for n in range(1, count + 1)]


def test_a_question_gets_its_answers_in_order_and_then_the_last_one_again() -> None:
    one, two, three = polls(3)
    move = Exchange(b"move\r", [b"ok\r"], 2.5)
    script = script_of([Exchange(b""), one, two, move, three], Dialect())
    assert [script.reply(b"poll\r") for _ in range(3)] == [[b"1\r"], [b"2\r"], [b"2\r"]]
    assert script.reply(b"move\r") == [b"ok\r"]
    assert [script.reply(b"poll\r") for _ in range(2)] == [[b"3\r"], [b"3\r"]]
    assert script.reply(b"other\r") == []


def test_answers_that_were_not_asked_for_are_passed_over_by_a_command() -> None:
    one, two, three = polls(3)
    move = Exchange(b"move\r", [b"ok\r"], 2.5)
    script = script_of([Exchange(b""), one, two, move, three], Dialect())
    assert script.reply(b"poll\r") == [b"1\r"]
    assert script.reply(b"move\r") == [b"ok\r"]
    assert script.reply(b"poll\r") == [b"3\r"]


def test_a_command_on_one_wire_takes_the_others_on() -> None:
    time, lines = EventTime(), Dialect()
    moves = [Exchange(b""), Exchange(b"move\r", [b"ok\r"], 3.0)]
    time.expect([], [3.0])
    robot = Script(moves, lines, time, {b"move"})
    strip = Script([Exchange(b""), *polls(5)], lines, time, ())
    assert [strip.reply(b"poll\r") for _ in range(3)] == [[b"1\r"], [b"2\r"], [b"2\r"]]
    assert robot.reply(b"move\r") == [b"ok\r"]
    assert [strip.reply(b"poll\r") for _ in range(3)] == [[b"3\r"], [b"4\r"], [b"5\r"]]


def test_one_that_is_asked_on_and_on_comes_to_the_next_part() -> None:
    """A question that a thread has asked by itself, once by chance, holds nobody up."""
    script = script_of([Exchange(b""), *polls(5)], Dialect(), 3.0)
    while (answers := script.reply(b"poll\r")) != [b"5\r"]:
        assert answers in ([b"1\r"], [b"2\r"], [b"3\r"], [b"4\r"])


def test_the_reply_to_c3_has_the_tag_of_the_question() -> None:
    def piece(event: str, text: str) -> Piece:
        return Piece(0.0, 1, event, text)  # type: ignore[arg-type] # one of the two

    pieces = [
        piece(">", "0100000e00000b24414343555f5354415445" + "0101000b00000824504f535f414354"),
        piece("<", "01010007000001310001"),
        piece("<", "01" + "0100001000000a234348415247455f4f4b000101"),
    ]
    c3 = dialects_of("kuka-c3")[""]
    script = script_of(exchanges(pieces, c3), c3)
    assert script.reply(bytes.fromhex("0777000b00000824504f535f414354"))[0][:2] == b"\x07\x77"
    assert b"#CHARGE_OK" in script.reply(bytes.fromhex("0778000e00000b24414343555f5354415445"))[0]
