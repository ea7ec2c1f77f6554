"""Recorded wires: where their messages end, what only numbers an exchange, how they are played."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.kuka.robot_c3 import decode_body, encode
from fakes.replay import player, recorded_cell
from fakes.replay.dialects import Dialect, Slcan, StripLine, dialects_of
from fakes.replay.player import (
    STUCK,
    ClockReadings,
    EventTime,
    Exchange,
    Flow,
    Names,
    RecordedWire,
    Script,
    connections,
    cut_connections,
    exchanges,
    shown,
)
from fakes.replay.recorded_cell import without_dialect
from fakes.universal_robots.dialect import Rtde
from fakes.wires import Listener
from hilcell.cell.file import load_cell
from hilcell.wire.channel import Socket, parse_channel
from hilcell.wire.recording import CLOCK, Piece

OUTPUTS, DATA = 79, 85
FIELDS = ("timestamp", "actual_q", "output_int_register_24", "output_int_register_26",
          "output_int_register_27", "input_int_register_28")  # fmt: skip
STATE = struct.Struct("!Bd6diiii")
WRITE = struct.Struct("!B4i6dd")
SCRIPT = b"def hilcell():\n  write_output_integer_register(26, %d)\nend\n"


def package(kind: int, payload: bytes) -> bytes:
    return struct.pack("!HB", 3 + len(payload), kind) + payload


def state(time_s: float, session: int, count: int, acknowledged: int = 0) -> bytes:
    return package(DATA, STATE.pack(1, time_s, *[0.25] * 6, acknowledged, session, count, 0))


def write(
    sequence: int, life: int, joint: float = 0.5, *, command: int = 1, stop: int = 0
) -> bytes:
    return package(DATA, WRITE.pack(1, sequence, command, life, stop, *[joint] * 6, 0.1))


def rtde() -> tuple[Rtde, Dialect]:
    """Return the dialects of both wires, which know where the fields of a state are."""
    found = dialects_of("ur-rtde")
    states, scripts = found["rtde"], found["script"]
    assert isinstance(states, Rtde)
    asked = package(OUTPUTS, struct.pack("!d", 125.0) + ",".join(FIELDS).encode())
    states.answer(asked, asked, package(OUTPUTS, b"\1DOUBLE,VECTOR6D,INT32,INT32,INT32,INT32"))
    return states, scripts


def values(message: bytes) -> tuple[float, int, int]:
    time_s, *_, session, count, _ = STATE.unpack(message[3:])[1:]
    return time_s, session, count


def test_a_driver_without_dialects_speaks_lines() -> None:
    assert dialects_of("t2sa-of-somebody") == {}
    lines = Dialect()
    assert lines.split(b"ACK-300 1,2\r\nERR-2") == ([b"ACK-300 1,2\r\n"], b"ERR-2")
    assert lines.split(b"1\r2\n") == ([b"1\r", b"2\n"], b"")
    assert lines.name(b"?LSTA\r") == lines.name(b"?LSTA\r\n")  # it came in two pieces
    assert lines.unheard(b"\n")


def test_a_target_that_was_computed_again_is_the_same_one() -> None:
    c3, tracker = dialects_of("kuka-c3")[""], dialects_of("leica-emscon")[""]
    ask = b"\0\7\0\2\1HC_TGT{E6AXIS: A1 %s, A2 -90.0}"
    moves = [c3.name(ask % number) for number in (b"-7.490565", b"-7.490564", b"-7.490765")]
    places = [
        tracker.name(struct.pack("<3I3di", 40, 0, 55, 1.5, x, -20.069405, 1))
        for x in (0.25, 0.25 + 3e-7, 0.26)
    ]
    for first, again, other in (moves, places):
        names = Names([first, b"$MODE_OP"])
        assert names.of(again) == first
        assert names.of(other) == other
    assert Names([b"Z", b"A0"]).of(b"X") == b"X"


def test_commands_of_a_strip_have_no_end() -> None:
    assert StripLine().split_questions(b"A0ZXA") == ([b"A0", b"Z", b"X"], b"A")
    assert StripLine().split(b"+0110042>\r0x0") == ([b"+0110042>\r"], b"0x0")


@pytest.mark.parametrize("driver", ["canopen", "kuka-e1"])
def test_a_strip_may_be_on_a_bus_or_a_line(driver: str) -> None:
    on_bus = dialects_of(driver, {"strip": {"driver": "canopen"}})["strip"]
    assert isinstance(on_bus, Slcan)
    assert isinstance(dialects_of(driver, {"strip": {"driver": "serial"}})["strip"], StripLine)


def test_documents_of_ethernetkrl() -> None:
    eki = dialects_of("kuka-eki")[""]
    ask, other = (b'<RobotCommand Id="%d" Type="0" Life="%d"></RobotCommand>' % each
                  for each in ((-5, 0), (-912, 1500)))  # fmt: skip
    move, next_move = (b'<RobotCommand Id="%d" Type="1"></RobotCommand>' % n for n in (3, 4))
    answer = b'<RobotState><Command Id="-5" Finished_Id="2"></Command></RobotState>'
    assert eki.split(ask + move + b"<Robot") == ([ask, move], b"<Robot")
    assert eki.name(ask) == eki.name(other) != eki.name(move) != eki.name(next_move)
    assert eki.belongs(answer, ask)
    assert not eki.belongs(answer, other)
    assert eki.answer(other, ask, answer) == answer.replace(b"-5", b"-912")
    assert eki.answer(other, move, answer) == answer  # one that came once more, with the next


def test_the_states_of_a_script_name_the_session_of_the_driver() -> None:
    states, scripts = rtde()
    assert scripts.split_questions(SCRIPT % 7 + b"def") == ([SCRIPT % 7], b"def")
    assert scripts.name(SCRIPT % 7) == scripts.name(SCRIPT % 8)
    assert values(states.answer(b"", b"", state(1.0, 7, 1)))[1] == 7
    scripts.heard(SCRIPT % 99, SCRIPT % 7)
    assert [values(states.answer(b"", b"", state(2.0, n, 9)))[1] for n in (0, 6, 7)] == [0, 6, 99]


def test_heartbeats_go_on_while_the_node_gave_any() -> None:
    time, rail = EventTime(), dialects_of("canopen")[""]
    answers = [b"t705105\r", b"t0858\r", b"t706105\r", b"t706105\r"]
    recorded = [Exchange(b""), Exchange(b"t000201\r", answers, came_s=[1.0, 1.0, 1.0, 9.0])]
    script = Script(recorded, rail, time)
    assert script.due() == []
    assert script.reply(b"t000201\r") == answers
    assert script.due() == [b"t705105\r", b"t706105\r"]
    time.reach(5.0)  # the drive had fallen silent
    assert script.due() == [b"t706105\r"]


def test_a_node_boots_once() -> None:
    """Its boot-up message would say that the node was reset, where a busy PC takes long."""
    time, rail = EventTime(), dialects_of("canopen")[""]
    answers = [b"t706100\r", b"t70517F\r"]
    recorded = [Exchange(b""), Exchange(b"t000281\r", answers, came_s=[1.0, 1.1])]
    script = Script(recorded, rail, time)
    script.reply(b"t000281\r")
    assert script.due() == [b"t70517F\r"]


def test_heartbeats_go_on_behind_a_cut_of_the_recording() -> None:
    """The other wires go on: a node that was alive at the cut is not to blame."""
    time, rail = EventTime(), dialects_of("canopen")[""]
    answers = [b"t706105\r", b"t705105\r", b"t0858\r"]
    recorded = [Exchange(b""), Exchange(b"t000201\r", answers, came_s=[1.0, 8.6, 9.0])]
    script = Script(recorded, rail, time, cut=True)
    script.reply(b"t000201\r")
    time.reach(90.0)
    assert script.due() == [b"t705105\r"]


@pytest.mark.parametrize("cut", [True, False])
def test_behind_a_cut_no_old_answer_stands_for_a_new_one(cut: bool) -> None:
    pieces = [
        Piece.of(1.0, 1, "open"), Piece.of(1.1, 1, ">", b"read\n"), Piece.of(1.2, 1, "<", b"0\n"),
        Piece.of(1.3, 1, ">", b"write 2\n"), Piece.of(1.4, 1, "<", b"written\n"),
        *([] if cut else [Piece.of(1.5, 1, "end")]),
    ]  # fmt: skip
    assert cut_connections(pieces) == [cut]
    (recorded,), time = connections(pieces, Dialect()), EventTime()
    time.expect([1.1, 1.3], [1.3])
    script = Script(recorded, Dialect(), time, {b"write 2"}, cut=cut)
    replies = [script.reply(asked) for asked in (b"read", b"read", b"write 2")]
    assert replies == [[b"0\n"], [b"0\n"], [b"written\n"]]
    assert script.reply(b"read") == ([] if cut else [b"0\n"])
    assert script.knows(b"read") is not cut


def test_a_question_behind_which_a_flow_was_cut_was_never_answered() -> None:
    states, _ = rtde()
    recorded = [Exchange(b""), Exchange(write(1, 0), [state(1.0, 1, 1)]), Exchange(write(2, 0))]
    assert Flow(recorded, states, EventTime()).knows(write(2, 0))
    recorded[-1].cut = True
    flow = Flow(recorded, states, EventTime())
    assert [flow.knows(write(number, 0)) for number in (1, 2, 3)] == [True, False, False]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (b"!HALT\r\n", "'!HALT'"),
        (bytes.fromhex("000b55 01") + b"abcdefg", "'abcdefg'"),
        (bytes.fromhex("0010") + b"ABC" + bytes(range(1, 30)),
         "00 10 41 42 43 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f 10 11 12 13 .. (hex)"),
    ],
)  # fmt: skip
def test_a_question_is_shown_as_text_or_in_hex(asked: bytes, words: str) -> None:
    assert shown(asked) == words


def test_a_wait_on_a_wire_that_was_cut_is_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0
    monkeypatch.setattr(player, "time", SimpleNamespace(monotonic=lambda: now_s))
    time = EventTime()
    time.expect([1.0, 50.0], [])
    time.end_at(60.0, "robot:9")
    time.cut_at(1.0, "rail:4")
    for at_s, left in ((0.9, ""), (1.0, "the recording ends at rail:4, and this run goes on")):
        time.reach(at_s)
        for _ in range(100):
            now_s += 0.02
            found = time.left()
        assert found == left


def test_a_command_that_was_sent_twice_parts_the_recording_twice() -> None:
    rail, time = dialects_of("canopen")[""], EventTime()
    sync, move = b"t0800\r", b"t20560F00C86D0B00\r"
    order = [sync, move, sync, sync, move, sync]
    recorded = [Exchange(b""), *(Exchange(q, [b"%d" % n], n) for n, q in enumerate(order, 1))]
    time.expect([], [2.0, 5.0])
    script = Script(recorded, rail, time, ())
    assert [script.reply(sync), script.reply(sync)] == [[b"1"], [b"1"]]
    assert [script.reply(move), script.reply(sync)] == [[b"2"], [b"3"]]
    assert [script.reply(move), script.reply(sync), script.reply(sync)] == [[b"5"], [b"6"], [b"6"]]


def test_a_question_sent_with_a_command_and_before_it_is_asked_before_it() -> None:
    pieces = [
        Piece.of(1.0, 1, ">", b"poll\nmove 1\n"), Piece.of(1.5, 1, "<", b"begins\n"),
        Piece.of(2.0, 1, ">", b"poll\n"), Piece.of(2.5, 1, "<", b"moves\n"),
        Piece.of(3.0, 1, ">", b"poll\n"), Piece.of(3.5, 1, "<", b"arrived\n"),
    ]  # fmt: skip
    recorded, time = exchanges(pieces, Dialect()), EventTime()
    asked_s = [each.time_s for each in recorded[1:]]
    time.expect(asked_s, asked_s[1:2])
    script = Script(recorded, Dialect(), time, {b"move 1"})
    replies = [script.reply(asked) for asked in (b"poll", b"move 1", b"poll", b"poll")]
    assert replies == [[], [b"begins\n"], [b"moves\n"], [b"arrived\n"]]


def test_a_sign_of_life_that_is_due_earlier_than_it_was_is_answered() -> None:
    time = EventTime()
    order = [(1.0, b"go 1"), (2.0, b"go 2"), (3.0, b"alive"), (4.0, b"alive")]
    recorded = [Exchange(b""), *(Exchange(asked, [b"ok"], at_s) for at_s, asked in order)]
    time.expect([at_s for at_s, _ in order], [1.0, 2.0])
    script = Script(recorded, Dialect(), time, {b"go 1", b"go 2"})
    assert [script.reply(asked) for asked in (b"go 1", b"alive")] == [[b"ok"]] * 2
    assert time.now_s == 1.0
    assert [script.reply(asked) for asked in (b"go 2", b"alive")] == [[b"ok"]] * 2
    assert time.now_s == 3.0


def test_no_old_answer_stands_for_one_that_a_stop_came_before() -> None:
    pieces = [Piece.of(1.0, 1, ">", b"measure\n"), Piece.of(1.5, 1, "<", b"7.1\n")]
    recorded, time = exchanges(pieces, Dialect()), EventTime()
    time.stop_at(2.0, "clock:3")
    time.expect([1.0], [])
    script = Script(recorded, Dialect(), time, {})
    assert [script.reply(b"measure"), time.left()] == [[b"7.1\n"], ""]
    assert [script.reply(b"measure"), time.left()] == [
        [], "the recording ends at clock:3, where its run was stopped"
    ]  # fmt: skip


def test_samples_of_a_stream_come_when_their_time_has_come() -> None:
    def packet(kind: int, number: int) -> bytes:
        return struct.pack("<3I", 12, kind, number)

    time, tracker = EventTime(), dialects_of("leica-emscon")[""]
    answers = [packet(3, 1), packet(0, 2), packet(3, 3), packet(3, 4)]
    start = Exchange(packet(0, 49), answers, 1.0, [1.1, 1.2, 1.3, 9.0])
    script = Script([Exchange(b""), start], tracker, time, ())
    assert script.reply(start.asked) == answers[:2]
    assert time.now_s == 1.1
    come = [script.come(at_s) for at_s in (1.2, 1.3, 8.9, 9.0)]
    assert come == [[], [answers[2]], [], [answers[3]]]


def test_the_clock_shows_what_it_showed_when_it_was_looked_at_next() -> None:
    time = EventTime()
    time.expect([1.0, 2.0, 3.0], [])
    looks = ClockReadings(time, [1.1, 1.2, 2.1, 2.9], [50.0, 50.5, 60.0, 70.0])
    time.reach(1.05)
    assert [looks.now_s(), looks.now_s()] == [50.0, 50.5]
    looks.wait(4.0)
    assert looks.now_s() == pytest.approx(54.5)  # one more than was recorded
    time.reach(2.05)
    assert looks.now_s() == 60.0
    assert time.now_s == 2.1  # what had come by that look has come
    time.reach(2.5)
    assert looks.now_s() == 70.0


def test_a_wait_that_was_not_recorded_shortens_none_that_was() -> None:
    """A dwell behind it would else be too short, and a slide not known to stand."""
    time = EventTime()
    time.expect([1.0, 2.0, 3.0], [])
    looks = ClockReadings(time, [1.1, 2.1, 3.1], [50.0, 50.1, 50.5])
    time.reach(1.05)
    assert looks.now_s() == 50.0
    looks.wait(0.3)
    assert looks.now_s() == pytest.approx(50.3)
    shown_s = []
    for asked_s in (2.0, 3.0):
        time.reach(asked_s)
        shown_s.append(looks.now_s())
    assert shown_s == pytest.approx([50.3, 50.7])


def test_no_time_of_the_pc_passes_on_the_recorded_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is paired by the clock would else be paired otherwise than it was."""
    now_s = 7.0
    monkeypatch.setattr(player, "time", SimpleNamespace(monotonic=lambda: now_s))
    time = EventTime()
    time.expect([1.0, 2.0], [])
    looks = ClockReadings(time, [1.1, 2.1], [50.0, 60.0])
    time.reach(1.05)
    shown_s = [looks.now_s()]
    for pause_s in (0.03, 1.7):
        now_s += pause_s
        shown_s.append(looks.now_s())
    looks.wait(0.5)
    assert [*shown_s, looks.now_s()] == [50.0, 50.0, 50.0, 50.5]


def moving(
    acknowledged: list[int], passed_s: list[float], asked_s: list[float]
) -> tuple[Flow, EventTime]:
    """Return the flow of a motion that was begun at 1.0, its states at 1.1, 1.2 .. .

    Other wires were asked at ``asked_s``, and questions for fresh states came at ``passed_s``.
    """
    states, _ = rtde()
    came_s = [1.1 + 0.1 * n for n in range(len(acknowledged))]
    answers = [
        state(t, 7, n, done) for n, (t, done) in enumerate(zip(came_s, acknowledged, strict=True))
    ]
    order = Exchange(write(1, 1), answers, 1.0, came_s, passed_s=passed_s)
    time = EventTime()
    time.expect([1.0, *asked_s], [1.0])
    flow = Flow([Exchange(b""), order], states, time)
    flow.reply(write(1, 500))
    return flow, time


def run(flow: Flow) -> float:
    """Let the controller send, however busy the driver is; return the last state's time."""
    return max(values(*flow.due())[0] for _ in range(20))


def test_states_wait_for_a_driver_that_was_asking_elsewhere() -> None:
    """A busy driver asks late: the states that came behind its question come behind it."""
    flow, time = moving([0, 1, 1, 1, 1], [], [1.25, 1.45])
    assert run(flow) == pytest.approx(1.2, abs=1e-3)
    time.reach(1.25)
    assert run(flow) == pytest.approx(1.4, abs=1e-3)
    time.reach(1.45)
    assert run(flow) == pytest.approx(1.5, abs=1e-3)


def test_a_motion_goes_on_whatever_was_asked_elsewhere_meanwhile() -> None:
    """A keep-alive asks when this PC wants it to; the driver waits for the end of the motion."""
    flow, time = moving([0, 0, 0, 1, 1], [], [1.15, 1.25, 1.45])
    assert run(flow) == pytest.approx(1.4, abs=1e-3)
    assert time.now_s == pytest.approx(1.4)


def test_a_state_behind_a_question_for_a_fresh_one_comes_behind_it() -> None:
    flow, _ = moving([0, 0, 0, 1, 1], [1.15, 1.45], [1.25])
    assert run(flow) == pytest.approx(1.1, abs=1e-3)
    flow.passed()
    assert run(flow) == pytest.approx(1.4, abs=1e-3)
    flow.passed()
    assert run(flow) == pytest.approx(1.5, abs=1e-3)


def test_fresh_states_asked_for_on_and_on_come_to_what_followed() -> None:
    """This driver does not ask elsewhere what the recorded one asked meanwhile."""
    flow, _ = moving([1, 1, 1], [], [1.15, 1.25])
    for end_s in (1.1, 1.2, 1.3):
        assert run(flow) == pytest.approx(end_s, abs=1e-3)
        for _ in range(STUCK):
            flow.passed()


def test_more_questions_for_fresh_states_than_before_pass_no_question_elsewhere() -> None:
    flow, time = moving([1, 1, 1, 1], [1.05, 1.35], [1.25])
    for _ in range(5):
        flow.passed()
    assert run(flow) == pytest.approx(1.2, abs=1e-3)
    assert time.heard_s == 1.05


def test_states_that_nobody_asked_for_move_no_clock() -> None:
    flow, time = moving([0, 0, 0, 1], [], [2.0])
    looks = ClockReadings(time, [1.05, 1.15, 1.35], [50.0, 60.0, 70.0])
    run(flow)
    assert time.now_s == pytest.approx(1.4)
    assert [looks.now_s() for _ in range(4)] == [50.0, 60.0, 70.0, 70.0]


def test_a_write_that_only_lives_asks_nothing_new() -> None:
    states, _ = rtde()
    name = states.name(write(3, 10))
    assert states.name(write(3, 11)) == name
    assert Names([name]).of(states.name(write(3, 11, 0.5 + 1e-9))) == name
    others = (write(4, 10), write(3, 10, 0.6), write(3, 10, stop=1), write(3, 10, command=0))
    assert name not in {Names([name]).of(states.name(each)) for each in others}


def test_every_state_has_the_number_of_the_last_question() -> None:
    states, _ = rtde()
    question = package(DATA, struct.pack("!Bi", 2, 4711))
    assert states.unheard(question)
    assert not states.unheard(write(3, 10))
    states.passed(question)
    assert STATE.unpack(states.answer(b"", b"", state(1.0, 7, 1))[3:])[-1] == 4711


def test_states_come_by_themselves_and_the_last_one_again() -> None:
    states, _ = rtde()
    moved = [state(1.0, 7, 1), state(1.2, 7, 3)]
    recorded = [
        Exchange(b""),
        Exchange(write(1, 1), moved, came_s=[1.0, 1.2]),
        Exchange(write(2, 9), [state(5, 7, 9)], came_s=[2.0]),
    ]
    flow = Flow(recorded, states, EventTime())
    assert flow.due() == []
    flow.reply(write(1, 500))
    found = [values(*flow.due()) for _ in range(5)]
    flow.reply(write(1, 501))  # a sign of life
    found.append(values(*flow.due()))
    times_s, _, counts = zip(*found, strict=True)
    assert times_s == pytest.approx([1.0] + 5 * [1.2], abs=1e-4)
    assert sorted(set(times_s)) == list(times_s)  # the controller's time never stands
    assert sorted(set(counts)) == list(counts)
    flow.reply(write(2, 502))
    assert values(*flow.due()) == (5, 7, 9)
    flow.reply(write(77, 503))
    assert flow.due() == []  # it was never asked: a device that hangs


@contextmanager
def wire(*connections: tuple[bytes, bytes]) -> Iterator[tuple[str, int]]:
    """Serve connections that were open at once, each with one question and its answer."""
    pieces = [Piece.of(0.1 * n, n, "open") for n in range(1, len(connections) + 1)]
    for n, (asked, answer) in enumerate(connections, 1):
        pieces += [Piece.of(n, n, ">", asked), Piece.of(n + 0.5, n, "<", answer)]
    pieces += [Piece.of(9, n, "end") for n in range(1, len(connections) + 1)]
    served = RecordedWire(pieces, Dialect(), EventTime(), "here")
    served.start()
    with closing(served):
        place = parse_channel(served.channel)
        assert isinstance(place, Socket)
        yield place.host, place.port


def test_connections_are_served_in_the_order_in_which_they_were_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A busy PC may run the thread of the second one first."""
    second, serve = threading.Event(), Listener._run
    one, two = socket.socket(), socket.socket()
    one.bind(("127.0.0.1", 0))
    first = one.getsockname()

    def run_later(self: Listener, client: socket.socket) -> None:
        if client.getpeername() == first:
            second.wait()
        serve(self, client)

    monkeypatch.setattr(Listener, "_run", run_later)
    with wire((b"first\n", b"1\n"), (b"second\n", b"2\n")) as place, one, two:
        try:
            one.connect(place)
            two.connect(place)
            two.sendall(b"second\n")
            assert two.recv(9) == b"2\n"
        finally:
            second.set()
        one.sendall(b"first\n")
        assert one.recv(9) == b"1\n"


def test_an_idle_connection_is_kept_alive_by_what_another_was_asked() -> None:
    with (
        wire((b"mode\nmode\n", b"1\n"), (b"stop\n", b"2\n")) as place,
        socket.create_connection(place),
        socket.create_connection(place) as two,
    ):
        two.sendall(b"mode\n")
        assert two.recv(9) == b"1\n"


def test_a_client_that_is_lost_ends_no_other_wire() -> None:
    """Time passes in the thread of the wire that is asked, and tells all others."""
    pieces = [Piece.of(0.1, 1, "open"), Piece.of(1, 1, ">", b"ask\n"), Piece.of(9, 1, "end")]
    time, (near, far) = EventTime(), socket.socketpair()
    served = RecordedWire(pieces, Dialect(), time, "here")
    served._take_note(near)
    serving = threading.Thread(target=served._serve, args=(near,))
    with closing(served), near, far:
        near.shutdown(socket.SHUT_WR)
        serving.start()
        while not time._followers:
            pass
        time.reach(2.0)
        far.close()
        serving.join()


def test_a_robot_takes_a_sign_of_life_that_was_never_given() -> None:
    """A motion that is over within the time of one, as it was recorded."""
    c3 = dialects_of("kuka-c3")[""]
    (reply,) = c3.alive(encode(7, "$TIMER[10]", "-1500"))
    assert reply[:4] == bytes((0, 7, 0, len(reply) - 4))
    assert decode_body(7, reply[4:]).value == "-1500"
    assert c3.alive(encode(8, "HC_STOP", "TRUE")) == []


def test_a_sign_of_life_lets_no_recorded_time_pass() -> None:
    """A late PC gives one earlier than was recorded; one that was never answered stays silent."""
    c3 = dialects_of("kuka-c3")[""]
    sign = encode(7, "$TIMER[10]", "-1500")
    (reply,) = c3.alive(sign)
    given = [Piece.of(5, 1, ">", sign), Piece.of(5, 1, "<", reply)]
    assert [each.asked for each in exchanges(given, c3)] == [b""]
    assert [each.asked for each in exchanges(given[:1], c3)] == [b"", sign]


@pytest.mark.parametrize(
    ("asked", "answer", "refused"),
    [
        (b"where?\r\n", b"1,2,3\r\n", ""),
        (b"where?\n", b"", ""),
        (b"", b"", ""),
        (b"MoveJoints(1,2)\0", b"[3004][1]\0", "the driver"),
        (b"<ask/>", b"<state/>", "the driver"),
        (b"where?\n", b"\x01\x00\x00\x10", "the device"),
        (b"\x02\n", b"1\n", "the driver"),
    ],
)
def test_a_wire_that_is_no_plain_lines_needs_a_dialect(
    asked: bytes, answer: bytes, refused: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = load_cell("paper")
    pieces = {
        CLOCK: [Piece.of(0.0, 0, "now", bytes(8))],
        "robot": [Piece.of(1.0, 1, ">", asked), Piece.of(1.1, 1, "<", answer)],
    }
    paths = {name: Path(f"{name}.wire.jsonl") for name in pieces}
    assert [*without_dialect(cell, paths, pieces)] == []  # that of its driver is stated
    monkeypatch.setattr(recorded_cell, "dialects_of", lambda *_: {})
    found = [*without_dialect(cell, paths, pieces)]
    assert len(found) == bool(refused)
    for each in found:
        assert each.startswith(f"robot.wire.jsonl: the bytes of {refused} are")
        assert cell.robot.driver in each
