"""The served nodes, frame by frame, as a master sees them: NMT, heartbeats, EMCY, PDOs, SDO."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.canopen.slave import (
    CanopenSlave,
    Entry,
    NodeIdentity,
    ObjectDictionary,
    SdoAbortError,
    SdoServer,
)
from tests.fakes.rail_bench import DRIVE, MASTER, STRIP, Bus, Line, Master, SdoAbort, served, until


def aborted(call: Callable[..., object], *args: object) -> int:
    """Return the abort code with which a call is refused."""
    with pytest.raises(SdoAbort) as refused:
        call(*args)
    return refused.value.code


# -- golden frames of CiA 301 -----------------------------------------------------------------


def test_boot_up_comes_after_open_and_once() -> None:
    with served() as bench:
        with Line(bench.server.port, opened=False) as line:
            line.send(b"S6")
            assert line.reply() == b"\r"
            assert line.quiet()
            line.send(b"O")
            assert line.reply() == b"\r"
            assert [line.frame(), line.frame()] == [b"t705100", b"t706100"]
        with Line(bench.server.port) as line:
            line.send(b"t60584000100000000000")
            assert line.frame() == b"t58584300100092010200", "the drive went on meanwhile"


def test_golden_sdo_frames(bus: Bus) -> None:
    for node, request, answer in (
        (DRIVE, "4064600000000000", "4364600000000000"),  # encoder 0 at power-on
        (DRIVE, "2B4060000F000000", "6040600000000000"),
        (DRIVE, "4000100000000000", "4300100092010200"),
        (STRIP, "4000100000000000", "4300100096010800"),
    ):
        assert bus.ask(node, bytes.fromhex(request)) == bytes.fromhex(answer)
    for request, code in (("4000700000000000", 0x06020000), ("2B41600000000000", 0x06010002)):
        assert aborted(bus.ask, DRIVE, bytes.fromhex(request)) == code


def test_golden_heartbeats(bus: Bus) -> None:
    bus.write(0x1017, 0, 20, "H")
    for command, state in ((b"", 0x7F), (b"\x01\x00", 0x05), (b"\x02\x05", 0x04)):
        if command:
            bus.send(0x000, command)
        bus.let_pass(0.1)
        assert bus.heard(0x705)[-1] == bytes([state])
    bus.send(0x605, bytes.fromhex("4000100000000000"))
    assert len(bus.heard(0x585)) == 1, "a stopped node answers no SDO"


def test_sync_brings_the_mapped_data() -> None:
    """To canopen, an independent master."""
    with served() as bench, Master(bench.server.port) as master:
        for number, entries in ((0, (0x60410010, 0x60640020)), (1, (0x606C0020, 0x60610008))):
            master.map_pdo(number, entries)
        master.map_pdo(0, (0x60040020, 0x65030010), STRIP)
        frames: list[tuple[int, bytes]] = []
        for cob_id in (0x185, 0x285, 0x186):
            master.network.subscribe(
                cob_id, lambda cob_id, data, _: frames.append((cob_id, bytes(data)))
            )
        master.network.nmt.send_command(1)
        master.network.sync.transmit()
        until(lambda: len(frames) == 3)
        assert [cob_id for cob_id, _ in frames] == [0x185, 0x285, 0x186]
        status, speed, strip = (data for _, data in frames)
        assert status == bytes.fromhex("500200000000")
        assert speed == bytes(5)
        assert int.from_bytes(strip[:4], "little") == master.read(0x6004, 0, "i", STRIP)
        assert strip[4:] == bytes(2)


# -- identity and objects ----------------------------------------------------------------------


def test_identities() -> None:
    with served() as bench, Master(bench.server.port) as master:
        drive = [master.read(0x1018, sub) for sub in range(1, 5)]
        strip = [master.read(0x1018, sub, "I", STRIP) for sub in range(1, 5)]
        assert drive == [0x484, 0x402, 1, 2014001]
        assert strip == [0x484, 0x406, 1, 2014002]
        assert master.drive.sdo.upload(0x1008, 0) == b"hilcell rail drive (simulated)"
        assert master.strip.sdo.upload(0x1008, 0) == b"hilcell strip sensor (simulated)"
        assert master.read(0x6501, 0, "H", STRIP) == master.read(0x6005, 1, "I", STRIP) == 10_000
        assert master.read(0x650B, 0, "I", STRIP) == 2014002


# -- mapping -----------------------------------------------------------------------------------


def test_mapping_needs_the_pdo_off_and_the_count_zero(bus: Bus) -> None:
    assert aborted(bus.write, 0x1A00, 0, 0, "B") == 0x08000022
    assert aborted(bus.write, 0x1800, 1, 0xC0000385, "I") == 0x08000022
    assert aborted(bus.write, 0x1801, 1, 0xC0000605, "I") == 0x06090030
    assert aborted(bus.write, 0x1801, 1, 0x80000285, "I") == 0x06090030, "bit 30"
    bus.write(0x1800, 1, 0xC0000185, "I")
    assert aborted(bus.write, 0x1A00, 1, 0x60640020, "I") == 0x08000022
    bus.write(0x1A00, 0, 0, "B")
    bus.write(0x1A00, 1, 0x60640020, "I")
    assert bus.read(0x1A00, 1) == 0x60640020


@pytest.mark.parametrize(
    ("entries", "code"),
    [
        ((0x70000020,), 0x06020000),
        ((0x10180120,), 0x06040041),
        ((0x60640010,), 0x06040041),
        ((0x60640020, 0x606C0020, 0x60610008), 0x06040042),
    ],
)
def test_count_judges_the_mapping(bus: Bus, entries: tuple[int, ...], code: int) -> None:
    assert aborted(bus.map_pdo, 0, entries) == code


def test_receive_pdo_too_short_is_an_emergency(bus: Bus) -> None:
    bus.start_nodes()
    bus.send(0x205, b"\x06")
    assert bus.emergencies() == [0x8210]
    assert bus.status() & 0x6F == 0x40


@pytest.mark.parametrize(
    ("emergencies", "register", "frames"),
    [
        ([(0x7305, 0x00)], 0x01, ["0573010000000000"]),  # any error sets the generic bit
        ([(0x8130, 0x10)], 0x11, ["3081110000000000"]),
        (
            [(0x7305, 0x20), (0x8130, 0x10), (0, 0x10)],
            0x21,
            ["0573210000000000", "3081310000000000", "0000210000000000"],
        ),
        ([(0x7305, 0x00), (0, 0x00)], 0x00, ["0573010000000000", "0000000000000000"]),
    ],
)
def test_error_register(
    emergencies: list[tuple[int, int]], register: int, frames: list[str]
) -> None:
    sent: list[tuple[int, str]] = []
    identity = NodeIdentity(0, "node", vendor=1, product=2, revision=3, serial=4)
    slave = CanopenSlave(5, identity, lambda cob_id, data: sent.append((cob_id, data.hex())))
    for emergency in emergencies:
        slave.emergency(*emergency)
    assert slave.dictionary.number(0x1001) == register
    assert sent == [(0x085, frame) for frame in frames]


@pytest.mark.parametrize(
    ("kind", "word", "sent"),
    [
        (3, None, [b"\x50\x02"] * 2),  # every third SYNC
        (0, 0x06, [b"\x50\x02", b"\x31\x02"]),  # changes only
    ],
)
def test_transmission_types(bus: Bus, kind: int, word: int | None, sent: list[bytes]) -> None:
    bus.map_pdo(0, (0x60410010,), kind=kind)
    bus.start_nodes()
    bus.sync(3)
    if word is not None:
        bus.control(word)
    bus.sync(4)
    assert bus.heard(0x185) == sent


def test_receive_pdo_on_sync_is_held_back(bus: Bus) -> None:
    bus.write(0x1400, 2, 1, "B")
    bus.start_nodes()
    bus.send(0x205, b"\x06\x00")
    assert bus.status() & 0x6F == 0x40
    bus.sync()
    assert bus.status() & 0x6F == 0x21


def test_event_timer_sends_by_itself(bus: Bus) -> None:
    bus.write(0x6200, 0, 20, "H", STRIP)
    assert bus.read(0x1800, 5, "H", STRIP) == 20
    bus.start_nodes()
    bus.let_pass(0.1)
    assert 4 <= len(bus.heard(0x186)) <= 6


# -- heartbeats and resets ---------------------------------------------------------------------


def test_reset_restores_the_defaults_and_boots(bus: Bus) -> None:
    bus.write(0x6081, 0, 1234, "I")
    bus.write(0x1016, 1, MASTER << 16 | 500, "I")
    boots = len(bus.heard(0x705))
    bus.send(0x000, b"\x82\x05")
    assert bus.heard(0x705)[boots:] == [b"\0"]
    assert bus.read(0x1016, 1) == 0
    assert bus.read(0x6081) == 1234
    bus.send(0x000, b"\x81\x05")
    assert bus.heard(0x705)[boots:] == [b"\0", b"\0"]
    assert bus.read(0x6081) == 250_000


def obeys(bus: Bus) -> bool:
    """Whether the drive takes a controlword by PDO."""
    bus.send(0x205, b"\x06\x00")
    return bus.status() & 0x6F == 0x21


def test_lost_heartbeat_is_an_emergency_and_ends_when_it_returns(bus: Bus) -> None:
    bus.write(0x1016, 1, MASTER << 16 | 100, "I")
    bus.start_nodes()
    for _ in range(20):
        bus.beat()
        bus.let_pass(0.09)
    assert bus.emergencies() == [], "as long as it beats all is well"
    bus.let_pass(0.1)
    assert bus.emergencies() == [0x8130]
    assert bus.read(0x1001, 0, "B") == 0x11
    assert bus.read(0x1003, 1) == 0x8130
    assert not obeys(bus), "out of OPERATIONAL: no PDOs"
    bus.beat()
    assert bus.emergencies() == [0x8130, 0]
    assert bus.read(0x1001, 0, "B") == 0


def test_no_heartbeat_is_punctual() -> None:
    beats_s: list[float] = []
    now_s = 0.0
    node = CanopenSlave(
        9, NodeIdentity(0, "n", 1, 1, 1, 1), lambda _cob_id, _data: beats_s.append(now_s)
    )
    node.dictionary.set(0x1017, 0, 200)
    node.boot(now_s)
    while len(beats_s) < 200:
        now_s = node.next_s()
        node.tick(now_s)
    gaps_s = [after - before for before, after in pairwise(beats_s)]
    assert 0.2 <= min(gaps_s) < 0.21
    assert 0.25 < max(gaps_s) <= 0.26


def test_start_before_the_first_new_heartbeat_does_not_hold(bus: Bus) -> None:
    bus.write(0x1016, 1, MASTER << 16 | 50, "I")
    bus.start_nodes()
    bus.beat()
    bus.let_pass(0.1)
    assert bus.emergencies() == [0x8130]
    bus.write(0x1016, 1, MASTER << 16 | 1000, "I")  # set again, and still latched
    bus.start_nodes()
    assert bus.emergencies() == [0x8130] * 2
    assert not obeys(bus), "no PDOs in PRE-OPERATIONAL"
    bus.beat()
    bus.start_nodes()
    assert obeys(bus)


def test_rewritten_consumer_waits_for_the_first_heartbeat(bus: Bus) -> None:
    bus.write(0x1016, 1, MASTER << 16 | 500, "I")
    bus.beat()
    bus.write(0x1016, 1, MASTER << 16 | 510, "I")
    bus.let_pass(2.0)
    assert bus.emergencies() == []


def server() -> tuple[SdoServer, ObjectDictionary]:
    objects = ObjectDictionary()
    objects.add(0x2000, 0, Entry("I", 7))
    objects.add(0x2001, 0, Entry("h", 0, allowed=range(-5, 6)))
    objects.add(0x2002, 0, Entry("s", "a name longer than four bytes", "ro"))
    objects.add(0x2003, 0, Entry("s", ""))
    objects.add(0x2004, 0, Entry("B", 1, "wo"))
    objects.add(0x2005, 0, Entry("H", 1, "ro"))
    objects.add(0x2006, 0, Entry("B", 0, write=refuse))
    objects.add_array(0x2010, Entry("H", 1), Entry("H", 2))
    return SdoServer(objects), objects


def refuse(_value: int) -> None:
    raise SdoAbortError(0x08000022)


def ask(sdo: SdoServer, request: str) -> str:
    reply = sdo.answer(bytes.fromhex(request))
    return "" if reply is None else reply.hex().upper()


def test_expedited() -> None:
    sdo, objects = server()
    assert ask(sdo, "4000200000000000") == "4300200007000000"
    assert ask(sdo, "23002000FFFFFFFF") == "6000200000000000"
    assert objects.number(0x2000) == 0xFFFFFFFF
    assert ask(sdo, "2B012000FBFF0000") == "6001200000000000"
    assert objects.number(0x2001) == -5
    assert ask(sdo, "4001200000000000") == "4B012000FBFF0000"
    assert ask(sdo, "22002000AABBCCDD") == "6000200000000000", "size not stated: the object's own"


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("4000300000000000", "00000206"),  # no such object
        ("4010200900000000", "11000906"),  # no such sub-index
        ("2B05200001000000", "02000106"),  # read only
        ("4004200000000000", "01000106"),  # write only
        ("2F00200001000000", "10000706"),  # length
        ("2B01200006000000", "30000906"),  # value range
        ("2F06200001000000", "22000008"),  # device state
        ("2102200010000000", "02000106"),  # segmented download to a read-only object
    ],
)
def test_abort_codes(request_: str, code: str) -> None:
    sdo, _ = server()
    assert ask(sdo, request_) == "80" + request_[2:8] + code


def test_unknown_command_and_stray_segment() -> None:
    sdo, _ = server()
    assert ask(sdo, "E000200000000000") == "8000200001000405"
    assert ask(sdo, "6000000000000000") == "8000000001000405", "no transfer is under way"


def test_a_segment_of_the_other_direction_ends_the_transfer() -> None:
    sdo, _ = server()
    ask(sdo, "4002200000000000")
    assert ask(sdo, "0141424344454647") == "8002200001000405"
    assert ask(sdo, "6000000000000000") == "8000000001000405", "no transfer is under way"


def test_segmented_upload() -> None:
    sdo, _ = server()
    text = "a name longer than four bytes"
    first = bytes.fromhex(ask(sdo, "4002200000000000"))
    assert first == bytes([0x41, 0x02, 0x20, 0x00]) + struct.pack("<I", len(text))
    data, toggle = b"", 0
    while True:
        reply = bytes.fromhex(ask(sdo, f"{0x60 | toggle:02X}00000000000000"))
        assert reply[0] & 0x10 == toggle
        data += reply[1 : 8 - (reply[0] >> 1 & 7)]
        toggle ^= 0x10
        if reply[0] & 1:
            break
    assert data.decode() == text
    assert ask(sdo, "7000000000000000")[:2] == "80", "the transfer has ended"


def test_toggle_must_alternate() -> None:
    sdo, _ = server()
    ask(sdo, "4002200000000000")
    ask(sdo, "6000000000000000")
    assert ask(sdo, "6000000000000000") == "8002200000000305"
    assert ask(sdo, "4000200000000000") == "4300200007000000", "the channel works again"


@given(st.text(st.characters(codec="ascii"), max_size=60))
def test_segmented_download(text: str) -> None:
    sdo, objects = server()
    data = text.encode()
    ask(sdo, "21032000" + struct.pack("<I", len(data)).hex())
    pieces = [data[i : i + 7] for i in range(0, len(data), 7)] or [b""]
    for number, piece in enumerate(pieces):
        last = number == len(pieces) - 1
        command = (number & 1) << 4 | (7 - len(piece)) << 1 | last
        reply = sdo.answer(bytes([command]) + piece.ljust(7, b"\0"))
        assert reply is not None
        assert reply[0] == 0x20 | (number & 1) << 4
    assert objects.entry(0x2003, 0).upload() == data


def test_announced_length_must_be_kept() -> None:
    sdo, _ = server()
    ask(sdo, "2103200008000000")
    assert ask(sdo, "0141424344454647") == "8003200010000706"


def test_clients_abort_is_not_answered() -> None:
    sdo, _ = server()
    ask(sdo, "4002200000000000")
    assert ask(sdo, "8002200000000405") == ""
    assert ask(sdo, "6000000000000000")[:2] == "80"
    assert ask(sdo, "40") == "", "a frame that is too short"
