"""A recorded wire is a device: a run repeats from its recording alone.

A driver that asks otherwise than before needs new recordings to be kept:

    HILCELL_RECORDINGS=write pytest tests/whole/test_record_wire.py
"""

from __future__ import annotations

import os
import pty
import shutil
import socket
import tty
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from fakes.dialects import DIALECTS, Dialect
from fakes.recorded_wire import Exchange, Script, exchanges
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.journal.runs import read_log
from hilcell.wire.channel import SerialLine, Socket
from hilcell.wire.record import WireRecording
from hilcell.wire.recording import SUFFIX, Piece, Recorder, read_recording
from hilcell.wire.relay import SerialRelay, SocketRelay
from tests.whole.bench import command

SWITCH = "HILCELL_RECORDINGS"
KEPT = Path(__file__).parent.parent / "wires"
SMALL = ["--unattended", "--set", "base_frame.points=4", "--set", "layout.nest_samples=2"]
RECORDED = ["--set", "simulation.simulator=recorded"]


def measured(folder: Path) -> dict[str, tuple[float, ...]]:
    """Return the measured positions of a run by key."""
    points = read_log(folder).points
    return {key: point.xyz_mm for key, point in points.items()}


def repeat(recording: Path, runs: Path, name: str) -> int:
    """Run again with a recording in place of the devices."""
    words = [*SMALL, *RECORDED, "--set", f"simulation.data={recording}"]
    return command("run", "base-frame", *words, "--runs", runs, "--name", name).returncode


def test_a_run_is_recorded_and_repeats_from_its_recording_alone(tmp_path: Path) -> None:
    words: list[str | Path] = [*SMALL, "--record-wire", "--runs", tmp_path, "--name", "first"]
    assert command("run", "base-frame", *words).returncode == 0
    assert repeat(tmp_path / "first", tmp_path, "again") == 0
    assert measured(tmp_path / "again") == measured(tmp_path / "first") != {}


@pytest.mark.parametrize("name", sorted(path.name for path in KEPT.iterdir()))
def test_a_kept_recording_repeats(name: str, tmp_path: Path) -> None:
    if os.environ.get(SWITCH) == "write":
        words: list[str | Path] = [*SMALL, "--record-wire", "--runs", tmp_path, "--name", "new"]
        assert command("run", name, *words).returncode == 0
        for path in (tmp_path / "new").glob(f"*{SUFFIX}"):
            shutil.copy(path, KEPT / name)
    assert repeat(KEPT / name, tmp_path, "kept") == 0
    assert measured(tmp_path / "kept")


def test_a_recording_that_ends_early_is_a_device_that_hangs(tmp_path: Path) -> None:
    """The run ends as it would have ended there, by the alarm of a lost tracker."""
    cut = tmp_path / "cut"
    cut.mkdir()
    for path in (KEPT / "base-frame").iterdir():
        lines = path.read_bytes().splitlines(keepends=True)
        kept = len(lines) // 2 if path.name.startswith("tracker") else len(lines)
        (cut / path.name).write_bytes(b"".join(lines[:kept]) + b'{"t":1.0,"c"')
    assert repeat(cut, tmp_path, "cut-run") == 3
    assert "Tracker" in str((read_log(tmp_path / "cut-run").end or {}).get("reason"))


def test_a_folder_without_recordings_is_refused() -> None:
    done = command("run", "home", *RECORDED, "--set", "simulation.data=/nowhere")
    assert done.returncode == 2
    assert "make one with `run --record-wire`" in done.stderr


# -- the relay -------------------------------------------------------------------------------------


@pytest.fixture
def kept(tmp_path: Path) -> Iterator[tuple[Recorder, Path]]:
    path = tmp_path / f"robot{SUFFIX}"
    with path.open("ab") as file:
        recorder = Recorder(file)
        yield recorder, path
        recorder.close()


def recorded_until(path: Path, event: str) -> list[Piece]:
    """Return a recording that has come so far; ends by the suite's own time limit."""
    while not (pieces := read_recording(path)) or pieces[-1].e != event:
        pass
    return pieces


def test_bytes_pass_unchanged_both_ways_and_are_kept(kept: tuple[Recorder, Path]) -> None:
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
    assert [(p.c, p.e, p.data) for p in pieces] == [
        (1, "open", b""), (1, ">", b"\x00\xffask"), (1, "<", b"answer\r\n"), (1, "lost", b""),
        (1, "end", b""),
    ]  # fmt: skip
    times = [piece.t for piece in pieces]
    assert times == sorted(times)


def test_a_device_that_is_not_there_hangs_up(kept: tuple[Recorder, Path]) -> None:
    recorder, path = kept
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    relay = SocketRelay(Socket("127.0.0.1", port), recorder)
    host, _, listening = relay.channel.removeprefix("socket://").partition(":")
    with socket.create_connection((host, int(listening))) as driver:
        assert driver.recv(1) == b""
    assert recorded_until(path, "refused")[0].e == "refused"


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
    for file in (driver, device, line):
        os.close(file)
    assert [p.e for p in read_recording(path)][:3] == ["open", ">", "<"]


def test_a_can_interface_is_left_out_with_its_reason(tmp_path: Path) -> None:
    cell = load_cell("paper")
    options = {"interface": "socketcan", "channel": "can0"}
    cell = msgspec.structs.replace(cell, rail=msgspec.structs.replace(cell.rail, options=options))
    recording = WireRecording(cell, {}, tmp_path)
    recording.close()
    assert recording.left_out == {
        "rail": "can0 is a CAN interface: record it with `candump -l can0`"
    }
    assert recording.addresses["robot"]["host"] == "127.0.0.1"


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text('{"t": 1.0, "c": 1, "e": "stop"}\n')
    with pytest.raises(SettingsError, match="no recording of a wire"):
        read_recording(path)


# -- the script ------------------------------------------------------------------------------------


def test_a_question_gets_its_answers_in_order_and_then_the_last_one_again() -> None:
    poll = [Exchange(b"poll\r", [b"1\r"]), Exchange(b"poll\r", [b"2\r"])]
    late = [Exchange(b"move\r", [b"ok\r"]), Exchange(b"poll\r", [b"3\r"])]
    script = Script([Exchange(b""), *poll, *late], Dialect())
    assert [script.reply(b"poll\r") for _ in range(3)] == [[b"1\r"], [b"2\r"], [b"2\r"]]
    assert script.reply(b"move\r") == [b"ok\r"]
    assert [script.reply(b"poll\r") for _ in range(2)] == [[b"3\r"], [b"3\r"]]
    assert script.reply(b"other\r") == []


def test_the_reply_to_c3_has_the_tag_of_the_question() -> None:
    def piece(event: str, text: str) -> Piece:
        return Piece(0.0, 1, event, text)  # type: ignore[arg-type] # one of the two

    pieces = [
        piece(">", "0100000e00000b24414343555f5354415445" + "0101000b00000824504f535f414354"),
        piece("<", "01010007000001310001"),
        piece("<", "01" + "0100001000000a234348415247455f4f4b000101"),
    ]
    c3 = DIALECTS["kuka-c3"]
    found = exchanges(pieces, c3)
    script = Script(found, c3)
    assert script.reply(bytes.fromhex("0777000b00000824504f535f414354"))[0][:2] == b"\x07\x77"
    assert b"#CHARGE_OK" in script.reply(bytes.fromhex("0778000e00000b24414343555f5354415445"))[0]
