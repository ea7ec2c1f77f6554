from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from importlib import resources

import canopen
import pytest

from drivers.canopen import sdo
from drivers.canopen.can_link import CanLink, open_bus
from drivers.canopen.sdo import Aborted, SdoChannel
from hilcell.ports import DeviceError, Stopped
from tests.clocks import DrivenClock
from tests.drivers.can_peer import DRIVE, CanPeer, u32
from tests.drivers.peers import WAIT_S

PROFILE_VELOCITY = (0x6081, 0)


@pytest.fixture(autouse=True)
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sdo, "REPLY_S", 0.1)
    monkeypatch.setattr(sdo, "LATE_S", 0.2)


@pytest.fixture
def peer() -> Iterator[CanPeer]:
    with CanPeer() as peer:
        peer.objects[DRIVE][PROFILE_VELOCITY] = u32(111)
        yield peer


@contextlib.contextmanager
def channel_to(peer: CanPeer, check: Callable[[], None] = lambda: None) -> Iterator[SdoChannel]:
    link = CanLink("Rail", open_bus("Rail", "slcan", peer.channel, 500_000), DrivenClock())
    with resources.as_file(resources.files("drivers.canopen") / "eds" / "drive.eds") as path:
        node = canopen.RemoteNode(DRIVE, canopen.import_od(str(path), DRIVE))
    channel = SdoChannel("Rail", DRIVE, node, link, check)
    link.network.add_node(node)
    try:
        yield channel
    finally:
        link.close()


def test_a_gateway_that_is_not_there_is_named_once() -> None:
    with pytest.raises(DeviceError) as caught:
        open_bus("Rail", "slcan", "/dev/no-gateway@115200", 500_000)
    found = "slcan /dev/no-gateway@115200: No such file or directory;"
    assert found in str(caught.value)


def test_a_value_is_typed_by_the_eds(peer: CanPeer) -> None:
    peer.objects[DRIVE][0x607C, 0] = u32(2**32 - 5)
    with channel_to(peer) as channel:
        assert channel.read(0x607C) == -5
        assert channel.read(*PROFILE_VELOCITY) == 111


@pytest.mark.parametrize(
    ("index", "answer", "value"),
    [
        (0x6081, "10 27", 10_000),  # a 32-bit object given in two bytes
        (0x607C, "fb ff", -5),
        (0x6007, "03 00 00 00", 3),  # a 16-bit object given in four
    ],
)
def test_an_integer_of_another_size_is_the_same_number(
    peer: CanPeer, index: int, answer: str, value: int
) -> None:
    peer.objects[DRIVE][index, 0] = bytes.fromhex(answer)
    with channel_to(peer) as channel:
        assert channel.read(index) == value


def test_an_answer_without_a_size_counts_by_its_type(peer: CanPeer) -> None:
    peer.tamper = lambda line: [line.replace(b"t585843076000", b"t585842076000")]
    peer.objects[DRIVE][0x6007, 0] = bytes.fromhex("03 00 ff ff")
    with channel_to(peer) as channel:
        assert channel.read(0x6007) == 3


def test_a_number_beyond_its_type_is_an_error_after_the_retry(peer: CanPeer) -> None:
    peer.objects[DRIVE][0x6007, 0] = u32(0x10003)
    with (
        channel_to(peer) as channel,
        pytest.raises(
            DeviceError,
            match=r"Rail: read 6007h:00: node 5: an answer of 4 bytes \(03 00 01 00\), "
            "wanted a number of 2 bytes, 3 times; check node 5",
        ),
    ):
        channel.read(0x6007)
    assert len(peer.frames(0x605)) > 3


def test_the_request_is_as_published(peer: CanPeer) -> None:
    with channel_to(peer) as channel:
        channel.read(0x6064)
    assert peer.frames(0x605) == [bytes.fromhex("4064600000000000")]


def test_a_write_is_read_back(peer: CanPeer) -> None:
    with channel_to(peer) as channel:
        channel.write(*PROFILE_VELOCITY, 222)
    assert peer.objects[DRIVE][PROFILE_VELOCITY] == u32(222)
    assert peer.frames(0x605)[-1] == bytes.fromhex("4081600000000000")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x06020000, "Object does not exist"),
        (0x06010002, "read only"),
        (0x08000022, "present device state"),
    ],
)
def test_an_abort_is_reported_and_taints_nothing(peer: CanPeer, code: int, words: str) -> None:
    peer.abort[0x6007, 0] = code
    with channel_to(peer) as channel:
        with pytest.raises(Aborted, match=f"0x{code:08X}, .*{words}") as caught:
            channel.read(0x6007)
        assert caught.value.abort_code == code
        assert channel.read(*PROFILE_VELOCITY) == 111


def test_silence_is_reported_after_three_tries(peer: CanPeer) -> None:
    peer.ignore.add(PROFILE_VELOCITY)
    with (
        channel_to(peer) as channel,
        pytest.raises(DeviceError, match=r"no answer within .* 3 times"),
    ):
        channel.read(*PROFILE_VELOCITY)


def test_a_late_reply_never_answers_the_next_read(peer: CanPeer) -> None:
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
    with channel_to(peer) as channel:
        assert channel.read(*PROFILE_VELOCITY) == 211
    assert u32(111).hex().upper().encode() in replies[0]
    assert len(replies) > 2


def test_values_that_differ_after_a_timeout_are_not_believed(peer: CanPeer) -> None:
    answers = iter([None, 1, 2, 3, 3])

    def answer(line: bytes) -> list[bytes]:
        if not line.startswith(b"t58584381600"):
            return [line]
        value = next(answers)
        return [] if value is None else [line[:13] + u32(value).hex().upper().encode() + b"\r"]

    peer.tamper = answer
    with channel_to(peer) as channel:
        assert channel.read(*PROFILE_VELOCITY) == 3


def test_a_truncated_reply_is_no_answer(peer: CanPeer) -> None:
    cut = iter([True])
    peer.tamper = lambda line: (
        [b"t585443816000\r"] if line.startswith(b"t58584381") and next(cut, False) else [line]
    )
    with channel_to(peer) as channel:
        assert channel.read(*PROFILE_VELOCITY) == 111


def test_the_reply_for_another_object_is_no_answer(peer: CanPeer) -> None:
    other = iter([True])
    peer.tamper = lambda line: (
        [line.replace(b"816000", b"836000")]
        if line.startswith(b"t58584381") and next(other, False)
        else [line]
    )
    with channel_to(peer) as channel:
        assert channel.read(*PROFILE_VELOCITY) == 111


def test_a_stop_ends_the_wait(peer: CanPeer) -> None:
    peer.ignore.add(PROFILE_VELOCITY)
    stop = threading.Event()

    def check() -> None:
        if stop.is_set():
            raise Stopped("a stop was asked for")

    with channel_to(peer, check) as channel:
        stop.set()
        with pytest.raises(Stopped):
            channel.read(*PROFILE_VELOCITY)


def test_two_threads_never_mix_their_answers(peer: CanPeer) -> None:
    peer.objects[DRIVE][0x6083, 0] = u32(333)
    wrong: list[int] = []

    def read(index: int, value: int, channel: SdoChannel) -> None:
        wrong.extend(found for _ in range(50) if (found := channel.read(index)) != value)

    with channel_to(peer) as channel:
        workers = [
            threading.Thread(target=read, args=(index, value, channel))
            for index, value in ((0x6081, 111), (0x6083, 333))
        ]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join(WAIT_S)
    assert wrong == []


def test_a_node_that_answers_each_question_twice_is_two_nodes(peer: CanPeer) -> None:
    with channel_to(peer) as channel:
        for _ in range(sdo.DOUBLES):
            assert channel.read(*PROFILE_VELOCITY) == 111
            channel._client.responses.put(bytes(8))
        with pytest.raises(DeviceError, match=f"node {DRIVE} has answered 3 questions") as error:
            channel.read(*PROFILE_VELOCITY)
    assert error.value.code == "HC-R45"


def test_a_frame_that_is_doubled_now_and_then_is_no_second_node(peer: CanPeer) -> None:
    with channel_to(peer) as channel:
        for number in range(4 * sdo.DOUBLES):
            assert channel.read(*PROFILE_VELOCITY) == 111
            if number % sdo.DOUBLES:
                channel._client.responses.put(bytes(8))
