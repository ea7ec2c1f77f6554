"""NMT, heartbeats, emergencies and PDOs of the served nodes, as a master sees them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import canopen
import pytest

from fakes.canopen.slave import CanopenSlave, NodeIdentity
from tests.fakes.rail_bench import DRIVE, STRIP, Line, Master, served, until


def aborted(call: Callable[..., object], *args: object) -> int:
    """Return the abort code with which a call is refused."""
    with pytest.raises(canopen.SdoAbortedError) as refused:
        call(*args)
    return int(refused.value.code)


# -- golden frames of protocols.md, section 1 --------------------------------------------------


def test_boot_up_comes_after_open_and_once() -> None:
    with served() as bench:
        with Line(bench.server.port, opened=False) as line:
            assert line.silent(0.05)
            line.send(b"O")
            assert line.reply() == b"\r"
            assert [line.frame(), line.frame()] == [b"t705100", b"t706100"]
        with Line(bench.server.port) as line:
            assert line.silent(0.05), "the drive went on while nobody was connected"


def test_golden_sdo_frames() -> None:
    with served() as bench, Line(bench.server.port) as line:
        line.frame()
        line.frame()
        for request, reply in {
            b"t60584064600000000000": b"t58584364600000000000",  # encoder 0 at power-on
            b"t60582B4060000F000000": b"t58586040600000000000",
            b"t60584000700000000000": b"t58588000700000000206",
            b"t60582B41600000000000": b"t58588041600002000106",
            b"t60584000100000000000": b"t58584300100092010200",
            b"t60684000100000000000": b"t58684300100096010800",
        }.items():
            line.send(request)
            assert line.frame() == reply


def test_golden_heartbeats() -> None:
    with served() as bench, Line(bench.server.port) as line:
        line.send(b"t60582B17100014000000")
        heard = [line.frame() for _ in range(5)]
        assert b"t70517F" in heard
        line.send(b"t00020100")
        until(lambda: line.frame() == b"t705105", "operational")
        line.send(b"t00020205")
        until(lambda: line.frame() == b"t705104", "stopped")
        line.send(b"t60584000100000000000")
        assert line.frame() == b"t705104", "a stopped node answers no SDO"


def test_sync_brings_the_mapped_data() -> None:
    with served() as bench, Master(bench.server.port) as master:
        for number, entries in ((0, (0x60410010, 0x60640020)), (1, (0x606C0020, 0x60610008))):
            remap(master, number, entries)
        remap(master, 0, (0x60040020, 0x65030010), STRIP)
        with_frames: list[tuple[int, bytes]] = []
        for cob_id in (0x185, 0x285, 0x186):
            master.network.subscribe(
                cob_id, lambda cob_id, data, _: with_frames.append((cob_id, bytes(data)))
            )
        master.network.nmt.send_command(1)
        master.network.sync.transmit()
        until(lambda: len(with_frames) == 3, "three TPDOs")
        assert [cob_id for cob_id, _ in with_frames] == [0x185, 0x285, 0x186]
        status, speed, strip = (data for _, data in with_frames)
        assert status == bytes.fromhex("500200000000")
        assert speed == bytes(5)
        assert int.from_bytes(strip[:4], "little") == master.read(0x6004, 0, "i", STRIP)
        assert strip[4:] == bytes(2)


def remap(
    master: Master, number: int, entries: tuple[int, ...], node: int = DRIVE, kind: int = 1
) -> None:
    """Map objects into a TPDO the way the standard asks for."""
    cob_id = 1 << 30 | 0x180 + 0x100 * number + node
    master.write(0x1800 + number, 1, cob_id | 1 << 31, "I", node)
    master.write(0x1800 + number, 2, kind, "B", node)
    master.write(0x1A00 + number, 0, 0, "B", node)
    for sub, entry in enumerate(entries, start=1):
        master.write(0x1A00 + number, sub, entry, "I", node)
    master.write(0x1A00 + number, 0, len(entries), "B", node)
    master.write(0x1800 + number, 1, cob_id, "I", node)


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


def test_wrong_identity() -> None:
    with served() as bench, Master(bench.server.port) as master:
        bench.faults.set("rail.wrong_identity", 0x999)
        assert master.read(0x1018, 2) == 0x999
        assert master.read(0x1018, 2) == 0x402


# -- mapping -----------------------------------------------------------------------------------


def test_mapping_needs_the_pdo_off_and_the_count_zero() -> None:
    with served() as bench, Master(bench.server.port) as master:
        assert aborted(master.write, 0x1A00, 0, 0, "B") == 0x08000022
        assert aborted(master.write, 0x1800, 1, 0xC0000385, "I") == 0x08000022
        assert aborted(master.write, 0x1801, 1, 0xC0000605, "I") == 0x06090030
        assert aborted(master.write, 0x1801, 1, 0x80000285, "I") == 0x06090030, "bit 30"
        master.write(0x1800, 1, 0xC0000185, "I")
        assert aborted(master.write, 0x1A00, 1, 0x60640020, "I") == 0x08000022
        master.write(0x1A00, 0, 0, "B")
        master.write(0x1A00, 1, 0x60640020, "I")
        assert master.read(0x1A00, 1) == 0x60640020


@pytest.mark.parametrize(
    ("entries", "code"),
    [
        ((0x70000020,), 0x06020000),
        ((0x10180120,), 0x06040041),
        ((0x60640010,), 0x06040041),
        ((0x60640020, 0x606C0020, 0x60610008), 0x06040042),
    ],
)
def test_count_judges_the_mapping(entries: tuple[int, ...], code: int) -> None:
    with served() as bench, Master(bench.server.port) as master:
        assert aborted(remap, master, 0, entries) == code


def test_receive_pdo_too_short_is_an_emergency() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.network.nmt.send_command(1)
        master.network.send_message(0x205, b"\x06")
        until(lambda: bool(master.drive.emcy.log), "EMCY")
        assert master.drive.emcy.log[0].code == 0x8210
        assert master.status() & 0x6F == 0x40


def test_transmission_types() -> None:
    with served() as bench, Master(bench.server.port) as master:
        remap(master, 0, (0x60410010,), kind=3)
        seen: list[bytes] = []
        master.network.subscribe(0x185, lambda _id, data, _t: seen.append(bytes(data)))
        master.network.nmt.send_command(1)
        for _ in range(7):
            master.network.sync.transmit()
        master.status()
        assert len(seen) == 2, "every third SYNC"


def test_acyclic_sync_sends_changes_only() -> None:
    with served() as bench, Master(bench.server.port) as master:
        remap(master, 0, (0x60410010,), kind=0)
        seen: list[bytes] = []
        master.network.subscribe(0x185, lambda _id, data, _t: seen.append(bytes(data)))
        master.network.nmt.send_command(1)
        for word in (None, None, 0x06, None):
            if word is not None:
                master.control(word)
            master.network.sync.transmit()
        master.status()
        assert seen == [b"\x50\x02", b"\x31\x02"]


def test_receive_pdo_on_sync_is_held_back() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.write(0x1400, 2, 1, "B")
        master.network.nmt.send_command(1)
        master.network.send_message(0x205, b"\x06\x00")
        assert master.status() & 0x6F == 0x40
        master.network.sync.transmit()
        assert master.status() & 0x6F == 0x21


def test_event_timer_sends_by_itself() -> None:
    with served() as bench, Master(bench.server.port) as master:
        seen: list[bytes] = []
        master.network.subscribe(0x186, lambda _id, data, _t: seen.append(bytes(data)))
        master.write(0x6200, 0, 20, "H", STRIP)
        assert master.read(0x1800, 5, "H", STRIP) == 20
        master.network.nmt.send_command(1)
        until(lambda: len(seen) >= 4, "cyclic TPDOs")


# -- heartbeats and resets ---------------------------------------------------------------------


def test_reset_restores_the_defaults_and_boots() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.write(0x6081, 0, 1234, "I")
        master.write(0x1016, 1, 127 << 16 | 500, "I")
        boots: list[int] = []
        master.drive.nmt.add_heartbeat_callback(boots.append)
        master.drive.nmt.state = "RESET COMMUNICATION"
        until(lambda: boots == [0], "boot-up")
        assert master.read(0x1016, 1) == 0
        assert master.read(0x6081) == 1234
        master.drive.nmt.state = "RESET"
        until(lambda: boots == [0, 0], "boot-up")
        assert master.read(0x6081) == 250_000


def test_lost_heartbeat_is_an_emergency_and_ends_when_it_returns() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.write(0x1016, 1, 127 << 16 | 1000, "I")  # a busy machine may beat late
        master.network.nmt.send_command(1)
        beats = master.start_heartbeat()
        assert master.drive.emcy.wait(timeout=1.1) is None, "as long as it beats all is well"
        beats.stop()
        until(lambda: [e.code for e in master.drive.emcy.active] == [0x8130], "EMCY 8130")
        assert master.read(0x1001, 0, "B") == 0x11
        assert master.read(0x1003, 1) == 0x8130
        master.network.send_message(0x205, b"\x06\x00")
        assert master.status() & 0x6F == 0x40, "out of OPERATIONAL: no PDOs"
        beats = master.start_heartbeat()
        until(lambda: not master.drive.emcy.active, "error reset")
        assert master.read(0x1001, 0, "B") == 0
        beats.stop()


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


def test_start_before_the_first_new_heartbeat_does_not_hold() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.write(0x1016, 1, 127 << 16 | 50, "I")
        master.network.nmt.send_command(1)
        master.network.send_message(0x77F, b"\x05")
        until(lambda: [e.code for e in master.drive.emcy.active] == [0x8130], "EMCY 8130")
        master.write(0x1016, 1, 127 << 16 | 1000, "I")  # set again, and still latched
        master.network.nmt.send_command(1)
        until(lambda: [e.code for e in master.drive.emcy.log] == [0x8130] * 2, "EMCY again")
        master.network.send_message(0x205, b"\x06\x00")
        assert master.status() & 0x6F == 0x40, "no PDOs in PRE-OPERATIONAL"
        master.network.send_message(0x77F, b"\x05")
        master.network.nmt.send_command(1)
        master.network.send_message(0x205, b"\x06\x00")
        until(lambda: master.status() & 0x6F == 0x21, "OPERATIONAL")


def test_rewritten_consumer_waits_for_the_first_heartbeat() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.write(0x1016, 1, 127 << 16 | 500, "I")
        master.network.send_message(0x77F, b"\x05")
        master.write(0x1016, 1, 127 << 16 | 510, "I")
        assert master.drive.emcy.wait(timeout=0.8) is None


def test_heartbeat_loss_of_one_node() -> None:
    with served() as bench, Line(bench.server.port) as line:
        for node in (b"5", b"6"):
            line.send(b"t60" + node + b"82B17100014000000")
        until(lambda: line.frame()[:4] == b"t706", "both beat")
        bench.faults.set("rail.heartbeat_loss", 5)
        until(lambda: line.frame()[:4] == b"t706", "the fault has struck")
        until(lambda: [line.frame()[:4] for _ in range(4)] == [b"t706"] * 4, "node 5 is silent")
        for command in (b"C", b"O"):
            line.send(command)
        until(lambda: line.frame()[:4] == b"t705", "the next channel hears it again")


# -- faults of the SDO channel -----------------------------------------------------------------


def test_sdo_abort_timeout_and_late_reply() -> None:
    with served() as bench, Master(bench.server.port) as master:
        bench.faults.set("rail.sdo_abort", 0x06010002)
        assert aborted(master.write, 0x6081, 0, 5, "I") == 0x06010002
        assert master.read(0x6081) == 250_000
        bench.faults.set("rail.sdo_timeout")
        with pytest.raises(canopen.SdoCommunicationError):
            master.read(0x6081)
        assert master.read(0x6081) == 250_000


def test_late_reply_meets_the_next_request() -> None:
    with served() as bench, Line(bench.server.port) as line:
        line.frame()
        line.frame()
        bench.faults.set("rail.late_reply", 0.1)
        line.send(b"t60584018100100000000")
        line.send(b"t60584018100200000000")
        assert line.frame() == b"t58584318100202040000"
        assert line.frame() == b"t58584318100184040000"
