from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from itertools import chain, repeat

import pytest

from drivers.canopen import can_link, sdo, slcan_bus
from drivers.canopen.can_link import CanLink, open_bus
from drivers.canopen.sdo import Aborted, SdoChannel, open_channel
from hilcell.ports import Stopped
from tests.clocks import DrivenClock
from tests.drivers.canopen.can_peer import DRIVE, CanPeer, u32
from tests.drivers.canopen.rail_bed import RailTime
from tests.drivers.peers import A_LOOK_S, in_thread, refusal

pytestmark = pytest.mark.waits

PROFILE_VELOCITY = (0x6081, 0)


@pytest.fixture(autouse=True)
def _short_limits(monkeypatch: pytest.MonkeyPatch, peer: CanPeer) -> None:
    """Let a pause of this PC count as one look, and none while a node still has a question."""
    monkeypatch.setattr(can_link.LinkTime, "PAUSE_S", A_LOOK_S)
    monkeypatch.setattr(slcan_bus, "select", RailTime(peer))
    monkeypatch.setattr(sdo, "REPLY_S", 0.2)
    monkeypatch.setattr(sdo.SdoChannel, "LATE_S", 0.1)


@contextlib.contextmanager
def channel_to(peer: CanPeer, check: Callable[[], None] = lambda: None) -> Iterator[SdoChannel]:
    peer.objects[DRIVE].setdefault(PROFILE_VELOCITY, u32(0))
    link = CanLink(open_bus("slcan", peer.channel, 500_000), DrivenClock())
    try:
        yield open_channel(link, DRIVE, "drive.eds", check)
    finally:
        link.close()


@pytest.fixture
def channel(peer: CanPeer) -> Iterator[SdoChannel]:
    peer.objects[DRIVE][PROFILE_VELOCITY] = u32(111)
    with channel_to(peer) as channel:
        yield channel


def test_a_gateway_that_is_not_there_is_named_once() -> None:
    found = refusal(lambda: open_bus("slcan", "/dev/no-gateway@115200", 500_000))
    assert found.code == "HC-R04"
    assert str(found).count("/dev/no-gateway") == 1


@pytest.mark.parametrize(
    ("index", "answer", "value"),
    [
        (0x6081, "6f 00 00 00", 111),
        (0x607C, "fb ff ff ff", -5),
        (0x6081, "10 27", 10_000),  # a 32-bit object given in two bytes
        (0x607C, "fb ff", -5),
        (0x6007, "03 00 00 00", 3),  # a 16-bit object given in four
    ],
)
def test_a_value_is_typed_by_the_eds_whatever_its_size(
    peer: CanPeer, channel: SdoChannel, index: int, answer: str, value: int
) -> None:
    peer.objects[DRIVE][index, 0] = bytes.fromhex(answer)
    assert channel.read(index) == value


def test_an_answer_without_a_size_counts_by_its_type(peer: CanPeer, channel: SdoChannel) -> None:
    peer.tamper = lambda line: [line.replace(b"t585843076000", b"t585842076000")]
    peer.objects[DRIVE][0x6007, 0] = bytes.fromhex("03 00 ff ff")
    assert channel.read(0x6007) == 3


def test_a_number_beyond_its_type_is_an_error_after_the_retry(
    peer: CanPeer, channel: SdoChannel
) -> None:
    peer.objects[DRIVE][0x6007, 0] = u32(0x10003)
    found = refusal(lambda: channel.read(0x6007))
    assert (found.code, found.fields["node"], found.fields["tries"]) == ("HC-R06", DRIVE, 3)
    assert "03 00 01 00" in found.found
    assert len(peer.frames(0x605)) > 3


def test_the_request_is_as_published(peer: CanPeer, channel: SdoChannel) -> None:
    channel.read(0x6064)
    assert peer.frames(0x605) == [bytes.fromhex("4064600000000000")]


def test_a_write_is_read_back(peer: CanPeer, channel: SdoChannel) -> None:
    channel.write(*PROFILE_VELOCITY, 222)
    assert peer.objects[DRIVE][PROFILE_VELOCITY] == u32(222)
    assert peer.frames(0x605)[-1] == bytes.fromhex("4081600000000000")


@pytest.mark.parametrize("code", [0x06020000, 0x08000022])
def test_an_abort_is_reported_and_taints_nothing(
    peer: CanPeer, channel: SdoChannel, code: int
) -> None:
    peer.abort[0x6007, 0] = code
    with pytest.raises(Aborted) as caught:
        channel.read(0x6007)
    assert caught.value.abort_code == code
    asked = len(peer.frames(0x605))
    assert channel.read(*PROFILE_VELOCITY) == 111
    assert len(peer.frames(0x605)) == asked + 1


def test_silence_is_reported_after_three_tries(peer: CanPeer, channel: SdoChannel) -> None:
    peer.ignore.add(PROFILE_VELOCITY)
    found = refusal(lambda: channel.read(*PROFILE_VELOCITY))
    assert (found.code, found.fields["tries"]) == ("HC-R06", 3)


def test_a_late_reply_never_answers_the_next_read(peer: CanPeer, channel: SdoChannel) -> None:
    """The first reply, 111, comes after its deadline; meanwhile the value has become 211."""
    replies: list[bytes] = []

    def delay(line: bytes) -> list[bytes]:
        if not line.startswith(b"t58584381600"):
            return [line]
        replies.append(line)
        if len(replies) == 1:
            peer.objects[DRIVE][PROFILE_VELOCITY] = u32(211)
            return []
        return [replies[0], line] if len(replies) == 2 else [line]

    peer.tamper = delay
    assert channel.read(*PROFILE_VELOCITY) == 211
    assert u32(111).hex().upper().encode() in replies[0]
    assert len(replies) > 2


def test_values_that_differ_after_a_timeout_are_not_believed(
    peer: CanPeer, channel: SdoChannel
) -> None:
    answers = chain([None, 1, 2], repeat(3))

    def answer(line: bytes) -> list[bytes]:
        if not line.startswith(b"t58584381600"):
            return [line]
        value = next(answers)
        return [] if value is None else [line[:13] + u32(value).hex().upper().encode() + b"\r"]

    peer.tamper = answer
    assert channel.read(*PROFILE_VELOCITY) == 3


@pytest.mark.parametrize(
    "spoil", [lambda _: b"t585443816000\r", lambda line: line.replace(b"816000", b"836000")]
)
def test_a_truncated_reply_or_that_for_another_object_is_no_answer(
    peer: CanPeer, channel: SdoChannel, spoil: Callable[[bytes], bytes]
) -> None:
    first = iter([True])
    peer.tamper = lambda line: [
        spoil(line) if line.startswith(b"t58584381") and next(first, False) else line
    ]
    assert channel.read(*PROFILE_VELOCITY) == 111


def test_a_stop_ends_the_wait(peer: CanPeer) -> None:
    peer.ignore.add(PROFILE_VELOCITY)

    def check() -> None:
        raise Stopped("a stop was asked for")

    with channel_to(peer, check) as channel, pytest.raises(Stopped):
        channel.read(*PROFILE_VELOCITY)


def test_two_threads_never_mix_their_answers(peer: CanPeer, channel: SdoChannel) -> None:
    peer.objects[DRIVE][0x6083, 0] = u32(333)
    found: dict[int, set[int]] = {0x6081: set(), 0x6083: set()}
    together = threading.Barrier(2)

    def read(index: int) -> None:
        together.wait()
        found[index] |= {channel.read(index) for _ in range(50)}

    with in_thread(lambda: read(0x6081)):
        read(0x6083)
    assert found == {0x6081: {111}, 0x6083: {333}}


def test_a_node_that_answers_each_question_twice_is_two_nodes(channel: SdoChannel) -> None:
    for _ in range(sdo.SdoChannel.DOUBLES):
        assert channel.read(*PROFILE_VELOCITY) == 111
        channel._client.responses.put(bytes(8))
    found = refusal(lambda: channel.read(*PROFILE_VELOCITY))
    assert (found.code, found.fields) == ("HC-R45", {"node": DRIVE, "doubles": 3})


def test_a_frame_that_is_doubled_now_and_then_is_no_second_node(channel: SdoChannel) -> None:
    for number in range(4 * sdo.SdoChannel.DOUBLES):
        assert channel.read(*PROFILE_VELOCITY) == 111
        if number % sdo.SdoChannel.DOUBLES:
            channel._client.responses.put(bytes(8))
