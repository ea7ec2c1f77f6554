from __future__ import annotations

import contextlib
import os
import select
import socket
import termios
import threading
import tty
from collections.abc import Callable
from types import SimpleNamespace

import can
import pytest

from drivers.canopen import slcan_bus
from drivers.canopen.can_link import open_bus
from drivers.canopen.slcan_bus import SlcanBus, has_long_stamp
from tests.drivers.peers import Server, refusal, send_apart, soon

pytestmark = pytest.mark.waits
PATIENT_S = 600.0
GOOD = b"t58584064600015CD5B07\r"


def received(data: list[bytes]) -> tuple[list[tuple[int, bytes]], SlcanBus]:
    """Return the frames that a bus makes of ``data`` before the marker frame 7FF."""
    with Server(_says([*data, b"t7FF0\r"])) as server:
        bus = SlcanBus(f"socket://127.0.0.1:{server.port}", 500_000)
        frames = []
        while (message := bus.recv(PATIENT_S)) is not None and message.arbitration_id != 0x7FF:
            frames.append((message.arbitration_id, bytes(message.data)))
        assert message is not None
        bus.shutdown()
    return frames, bus


def _says(
    pieces: list[bytes], answers: dict[bytes, bytes] | None = None
) -> Callable[[socket.socket], None]:
    """Return a gateway that answers the commands of opening, and then sends some pieces."""

    def handle(connection: socket.socket) -> None:
        asked = b""
        while asked != b"O":
            asked = _command(connection)
            connection.sendall((answers or {}).get(asked, b"\r"))
        send_apart(connection, pieces)
        while connection.recv(100):
            pass

    return handle


def _command(connection: socket.socket) -> bytes:
    command = b""
    while (byte := connection.recv(1)) != b"\r":
        if not byte:
            raise EOFError
        command += byte
    return command


@pytest.fixture
def mute(monkeypatch: pytest.MonkeyPatch) -> None:
    """The gateway answers no command, and nobody waits for that."""
    monkeypatch.setattr(slcan_bus.SlcanBus, "ANSWER_S", 0.0)


FRAME = (0x585, bytes.fromhex("4064600015CD5B07"))


@pytest.mark.usefixtures("mute")
def test_the_channel_is_opened_and_a_frame_is_sent_as_published() -> None:
    heard: list[bytes] = []

    def listen(connection: socket.socket) -> None:
        while data := connection.recv(100):
            heard.append(data)

    with Server(listen) as server:
        bus = SlcanBus(f"socket://127.0.0.1:{server.port}", 500_000)
        data = bytes.fromhex("4064600000000000")
        bus.send(can.Message(arbitration_id=0x605, data=data, is_extended_id=False))
        bus.shutdown()
        soon(lambda: b"".join(heard).count(b"C\r") == 2)
    text = b"".join(heard)
    assert text == b"\rC\rS6\rO\rt60584064600000000000\rC\r"


@pytest.mark.parametrize(
    "pieces",
    [[GOOD[:7], GOOD[7:]], [bytes([byte]) for byte in GOOD], [b"z\r\r" + GOOD + b"Z\r"]],
)
def test_frames_arrive_whole(pieces: list[bytes]) -> None:
    frames, bus = received(pieces)
    assert frames == [FRAME]
    assert bus.bad_lines == 0


@pytest.mark.parametrize(
    "bad",
    [
        b"\x80\xff\r",
        b"t58\xb584064600015CD5B07\r",
        b"t5858406460\r",
        b"t585940646000\r",
        b"t58X84064600015CD5B07\r",
        b"hello\r",
        b"T0000058510\r",
        b"x" * 200 + b"\r",
        b"\xfe" + GOOD,  # a garbage byte costs one line
    ],
)
def test_bad_lines_are_dropped_and_counted(bad: bytes) -> None:
    frames, bus = received([bad, GOOD + GOOD[:-1] + b"12AB\r"])
    assert frames == [FRAME, FRAME]
    assert bus.bad_lines >= 1


def test_a_refusal_is_counted() -> None:
    _, bus = received([GOOD, b"\a", GOOD, b"z\r\a"])
    assert bus.refused == 2


@pytest.mark.parametrize(
    ("answers", "opened"),
    [
        ({b"": b"\a", b"C": b"\a"}, True),  # of a channel that is closed
        ({b"": b"", b"C": b"\a"}, True),
        (dict.fromkeys((b"", b"C", b"S6", b"O"), b""), True),
        (dict.fromkeys((b"", b"C", b"S6", b"O"), b"\r\n"), True),
        ({b"C": GOOD + b"\r"}, True),  # it was open, and says so
        ({b"S6": b"\a"}, False),
        ({b"O": b"\a"}, False),
        ({b"": b"", b"S6": b"\a"}, False),
        ({b"": b"\r\n", b"C": b"\a", b"S6": b"\r\n", b"O": b"\a"}, False),
    ],
)
def test_a_gateway_that_refuses_to_open_is_named_whatever_else_it_answers(
    answers: dict[bytes, bytes], opened: bool
) -> None:
    with Server(_says([GOOD, b"t7FF0\r"], answers)) as server:
        channel = f"socket://127.0.0.1:{server.port}"
        if not opened:
            with pytest.raises(can.CanInitializationError):
                SlcanBus(channel, 500_000)
            found = refusal(lambda: open_bus("slcan", channel, 500_000))
            assert (found.code, found.fields["bitrate"]) == ("HC-R04", 500_000)
            return
        bus = SlcanBus(channel, 500_000)
        frames = [bus.recv(PATIENT_S) for _ in range(2)]
        assert [each.arbitration_id for each in frames if each] == [0x585, 0x7FF]
        assert (bus.refused, bus.bad_lines) == (0, 0)
        bus.shutdown()


def test_a_frame_with_a_stamp_of_32_bits_is_a_line_of_another_form() -> None:
    frames, bus = received([b"t7051050123ABCD\r", GOOD])
    assert frames == [FRAME]
    assert bus.bad_lines == 1
    assert has_long_stamp(bus.bad_line)
    assert not has_long_stamp(GOOD[:-1])
    assert not has_long_stamp(b"t70510512")


@pytest.mark.parametrize(
    ("end", "acknowledges", "stamp"), [(b"\r\n", b"", b""), (b"\r", b"z", b"12AB")]
)
def test_gateways_differ_in_ends_acknowledges_and_time_stamps(
    end: bytes, acknowledges: bytes, stamp: bytes
) -> None:
    pieces = [b"t705105" + stamp + end]
    if acknowledges:
        pieces = [*pieces, acknowledges + end]
    frames, bus = received([*pieces, b"t70617F" + stamp + end, b"\a"])
    assert frames == [(0x705, b"\x05"), (0x706, b"\x7f")]
    assert (bus.bad_lines, bus.refused) == (0, 1)


def test_extended_and_remote_frames_are_frames() -> None:
    lines = [b"T000005851AA\r", b"r1858\r", b"R0000018580102\r"]
    with Server(_says([*lines, GOOD])) as server:
        bus = SlcanBus(f"socket://127.0.0.1:{server.port}", 500_000)
        found = [bus.recv(PATIENT_S) for _ in range(4)]
        bus.shutdown()
    assert [(m.is_extended_id, m.is_remote_frame, m.dlc) for m in found if m] == [
        (True, False, 1), (False, True, 8), (True, True, 8), (False, False, 8)
    ]  # fmt: skip
    assert bus.bad_lines == 0


# -- writing ----------------------------------------------------------------------------------


def frame(cob_id: int) -> can.Message:
    return can.Message(arbitration_id=cob_id, data=bytes(8), is_extended_id=False)


class SerialLine:
    """A serial line whose far side takes nothing until it is let, then all until the end."""

    def __init__(self) -> None:
        self._far, near = os.openpty()
        self.bus = SlcanBus(f"{os.ttyname(near)}@115200", 500_000)
        os.close(near)
        self._reader = threading.Thread(target=self._read)
        self.heard = b""

    def stop(self) -> None:
        """Take nothing, also where the kernel makes room later than a test waits."""
        termios.tcflow(self.bus._port, termios.TCOOFF)

    def read_on(self) -> None:
        with contextlib.suppress(termios.error, ValueError):  # of a port that was closed
            termios.tcflow(self.bus._port, termios.TCOON)
        self._reader.start()

    def close(self) -> None:
        self.bus.shutdown()
        self.join()

    def join(self) -> None:
        self._reader.join()
        os.close(self._far)

    def _read(self) -> None:
        with contextlib.suppress(OSError):  # EIO: the near side was closed
            while data := os.read(self._far, 4096):
                self.heard += data


@pytest.fixture
def line(mute: None) -> SerialLine:
    return SerialLine()


def jam(line: SerialLine) -> int:
    """Send until the port takes no more, part of the last line at most; return how many lines."""
    for count in range(10_000):
        try:
            line.bus.send(frame(0x100), timeout=0.1)  # the kernel makes room a little later
        except can.CanOperationError:
            line.stop()
            return count + 1
    raise AssertionError("the port takes everything")


def test_a_complete_write_is_never_too_late(
    line: SerialLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slcan_bus.SlcanBus, "SEND_S", 1e-9)
    line.bus.send(frame(0x123))
    line.read_on()
    line.close()
    assert line.heard == b"\rC\rS6\rO\rt1238" + b"0" * 16 + b"\rC\r"


def test_lines_never_mix_and_a_stop_gets_out_behind_writers_that_hang(line: SerialLine) -> None:
    jammed = jam(line)
    writers = [
        threading.Thread(target=line.bus.send, args=(frame(0x200 + n), PATIENT_S)) for n in range(3)
    ]
    for writer in writers:
        writer.start()
    assert all(writer.is_alive() for writer in writers)
    stop = threading.Thread(target=line.bus.send, args=(frame(0x205), PATIENT_S))
    stop.start()
    line.read_on()
    for writer in (stop, *writers):
        writer.join()
    line.close()
    lines = line.heard.split(b"\r")[4:-2]
    assert all(len(line) == 21 for line in lines)
    assert sorted(lines[jammed:]) == [
        b"t%03X8" % cob_id + b"0" * 16 for cob_id in (0x200, 0x201, 0x202, 0x205)
    ]


def test_a_port_that_takes_nothing_is_an_error_in_time(line: SerialLine) -> None:
    jam(line)
    with pytest.raises(can.CanOperationError):
        line.bus.send(frame(0x205))
    line.read_on()
    line.close()


def test_a_port_that_is_closed_under_a_writer_is_an_error_of_the_bus(
    line: SerialLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A jammed writer waits for the port while another thread closes it."""
    wait = select.select
    jam(line)

    def closed(reading: list[int], writing: list[int], failing: list[int], wait_s: float) -> object:
        line.bus._close_port()
        return wait(reading, writing, failing, wait_s)

    monkeypatch.setattr(slcan_bus, "select", SimpleNamespace(select=closed))
    with pytest.raises(can.CanOperationError):
        line.bus.send(frame(0x205))
    with pytest.raises(can.CanOperationError):
        line.bus.shutdown()
    line.read_on()
    line.join()


def test_a_bus_that_was_shut_down_writes_to_no_file_that_has_its_number_now(
    line: SerialLine,
) -> None:
    line.read_on()
    number = line.bus._port
    line.close()
    reading, writing = os.pipe()
    os.dup2(writing, number)
    try:
        with pytest.raises(can.CanOperationError):
            line.bus.send(frame(0x205))
        with pytest.raises(can.CanOperationError):
            line.bus.recv(PATIENT_S)
        os.close(writing)
    finally:
        os.close(number)
    assert os.read(reading, 1) == b""
    os.close(reading)


@pytest.mark.usefixtures("mute")
def test_a_gateway_on_a_serial_line_is_this_program_s_alone() -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    channel = f"{os.ttyname(theirs)}@115200"
    os.write(ours, b"t7FF0\rt58")  # from before this program
    bus = SlcanBus(channel, 500_000)
    with pytest.raises((OSError, can.CanError)):
        SlcanBus(channel, 500_000)
    os.write(ours, b"\r\r\r\rt58\xb5" + GOOD + GOOD[:9])
    os.write(ours, GOOD[9:])
    message = bus.recv(PATIENT_S)
    assert message is not None
    assert (message.arbitration_id, bytes(message.data)) == FRAME
    assert bus.bad_lines == 1
    os.close(ours)  # pulled out
    with pytest.raises(can.CanOperationError):
        bus.recv(PATIENT_S)
    with contextlib.suppress(can.CanError):
        bus.shutdown()
    os.close(theirs)
    again = os.openpty()
    os.close(again[0])
    os.close(again[1])
    assert again[0] <= theirs  # no descriptor has leaked
