"""A recording that is not whole, or not of this run, blames no device."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import msgspec
import pytest

from drivers.canopen import rail, sdo
from hilcell.journal.index import row_of
from hilcell.journal.runs import read_log
from hilcell.wire.recording import SUFFIX, Piece, read_recording, recordings
from tests.whole.bench import command, sets
from tests.whole.recordings import KEPT, PAIRS, SMALL, played

pytestmark = pytest.mark.waits

ENDED = "HC-C26"
RAN = "home"
KILLED = "kuka-c3,leica-emscon,canopen-swept"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    runs = tmp_path_factory.mktemp("runs")
    done = command("run", RAN, "--unattended", "--record-wire", "--runs", runs, "--name", "whole")
    assert done.returncode == 0, done.stderr
    return runs / "whole"


@pytest.fixture
def recorded(whole: Path, tmp_path: Path) -> Path:
    """Return a copy of its recording that a test may spoil."""
    folder = tmp_path / "recorded"
    folder.mkdir()
    for path in recordings(whole).values():
        shutil.copy(path, folder)
    return folder


def replayed(
    folder: Path, *words: str, run: str = RAN, runs: Path | None = None
) -> CompletedProcess[str]:
    where = ("--runs", folder.parent / "replays" if runs is None else runs, "--name", "again")
    return command("run", run, *words, *sets(played(folder)), "--unattended", *where)


def refused(folder: Path, *words: str, run: str = RAN) -> str:
    """Return why a recording is refused before there is a run."""
    done = replayed(folder, *words, run=run)
    assert (done.returncode, done.stdout) == (2, "")
    assert not (folder.parent / "replays").exists()
    return done.stderr


def lines_of(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines(keepends=True)


def fault(folder: Path) -> dict[str, Any]:
    end = read_log(folder).end
    assert end is not None
    return end.error


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda data: b"", ""),
        (lambda data: data[:-9], ":{lines},"),
        (lambda data: data.replace(b'"t":', b'"t":1', 1), ":1 "),
        (lambda data: b"\n" + data, ":1 "),
    ],
)
def test_a_file_that_is_not_whole_is_refused_with_its_line(
    spoil: Callable[[bytes], bytes], line: str, recorded: Path
) -> None:
    path = recorded / f"tracker{SUFFIX}"
    lines = len(lines_of(path))
    path.write_bytes(spoil(path.read_bytes()))
    said = refused(recorded)
    assert f"{path.name}: no recording of a wire" in said
    assert line.format(lines=lines) in said


def empty(folder: Path) -> None:
    for wire in ("rail", "robot"):
        (folder / f"{wire}{SUFFIX}").write_bytes(b"")


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (empty, [f"rail{SUFFIX}", f"robot{SUFFIX}"]),  # all at once
        (
            lambda folder: shutil.copy(folder / f"tracker{SUFFIX}", folder / f"robot{SUFFIX}"),
            [f"robot{SUFFIX}: it was recorded as tracker{SUFFIX}"],
        ),
        (lambda folder: (folder / f"clock{SUFFIX}").unlink(), [f"no clock{SUFFIX}"]),
        (lambda folder: folder.rename(folder.parent / "moved"), ["no such folder"]),
    ],
    ids=["empty files", "renamed file", "no clock", "no folder"],
)
def test_an_incomplete_recording_is_refused_with_its_files(
    spoil: Callable[[Path], object], named: list[str], recorded: Path
) -> None:
    spoil(recorded)
    message = refused(recorded)
    assert [each for each in named if each not in message] == []


@pytest.mark.parametrize(
    ("head", "found"),
    [
        (None, f"clock{SUFFIX}: does not state the recorded run"),
        ({"run": "r"}, "form none, expected 1"),
        ({"run": "r", "form": 99}, "form 99, expected 1"),
    ],
)
def test_a_recording_of_another_form_is_refused(
    head: dict[str, Any] | None, found: str, recorded: Path
) -> None:
    path = recorded / f"clock{SUFFIX}"
    first = Piece.of(0.0, 0, "run", msgspec.json.encode(head))
    lines = [msgspec.json.encode(first) + b"\n"] if head else []
    path.write_bytes(b"".join([*lines, *lines_of(path)[1:]]))
    assert found in refused(recorded)


@pytest.mark.parametrize(
    ("words", "run", "found"),
    [
        ((), "world-frame", "world-frame --seed 1"),
        (("--seed", "2"), RAN, "home --seed 2"),
        (("--cell", "lab"), RAN, "'lab'"),
        (("--set", "tracker.reading_s=0.7"), RAN, "tracker.reading_s 0.5 -> 0.7"),
        (("--set", "rail.options.drive_node=9"), RAN, "rail.options.drive_node None -> 9"),
    ],
)
def test_another_run_than_the_recorded_one_is_refused(
    words: tuple[str, ...], run: str, found: str, recorded: Path
) -> None:
    assert found in refused(recorded, *words, run=run)


def test_addresses_may_be_others_and_two_replay_at_once(recorded: Path, tmp_path: Path) -> None:
    other = ("--set", "robot.options.host=10.0.0.1", "--set", "robot.options.port=7001")
    inner: list[int] = []

    def hear(event: dict[str, Any]) -> None:
        if event["kind"] == "frame" or (event["kind"] == "state" and not inner):
            inner.append(replayed(recorded, *other, runs=tmp_path / "inner").returncode)

    words = ["--unattended", "--json", "--runs", str(tmp_path / "outer"), "--name", "again"]
    assert command("run", RAN, *sets(played(recorded)), *words, hear=hear).returncode == 0
    assert inner[:1] == [0]


@pytest.fixture
def _nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait shortly where a recording has ended."""
    monkeypatch.setattr(rail.Release, "RELEASE_S", 0.2)
    monkeypatch.setattr(sdo.SdoChannel, "LATE_S", 0.05)


def cut(path: Path, behind: bytes = b"") -> None:
    """Keep a recording up to the answer to a question, or its first half."""
    lines, pieces = lines_of(path), read_recording(path)
    asked = (n for n, piece in enumerate(pieces, 1) if piece.e == ">" and behind in piece.data)
    path.write_bytes(b"".join(lines[: next(asked) + 1 if behind else len(lines) // 2]))


@pytest.mark.usefixtures("_nobody_answers")
@pytest.mark.parametrize(
    ("wire", "behind"),
    [
        ("tracker", b""),
        ("robot", b""),
        ("rail", b""),
        ("rail", b"t60582F001A0002"),  # that object was read before: HC-R09
        ("rail", b"t60582F60600006"),  # all are connected: HC-C03
    ],
)
def test_a_recording_that_was_cut_ends_at_its_line(
    wire: str, behind: bytes, recorded: Path
) -> None:
    path = recorded / f"{wire}{SUFFIX}"
    cut(path, behind)
    done = replayed(recorded)
    assert done.returncode in (2, 3)  # as to whether anything had moved
    error = fault(recorded.parent / "replays" / "again")
    assert error["code"] == ENDED
    assert f"{path}:" in str(error["found"])
    assert "the recorded run, or record it again" in done.stderr
    assert "hilcell resume" not in done.stderr
    assert "E-stop" not in done.stderr  # no device was reached


def test_a_robot_that_was_cut_moves_until_there(recorded: Path) -> None:
    """The end of its idle connection for stops is missing, too."""
    path = recorded / f"robot{SUFFIX}"
    path.write_bytes(b"".join(lines_of(path)[:-8]))
    assert "opens that wire" not in (done := replayed(recorded)).stderr
    assert done.returncode in (0, 3)


@pytest.mark.usefixtures("_nobody_answers")
def test_a_recording_that_was_cut_in_its_closing_leaves_nothing_to_stop(recorded: Path) -> None:
    cut(
        recorded / f"rail{SUFFIX}", b"t60582316100100000000"
    )  # the drive's watch on the PC is taken off
    done = replayed(recorded)
    assert (done.returncode, "E-stop" in done.stderr) == (0, False)


def test_a_wire_of_which_only_the_beginning_is_left_ends_the_replay(recorded: Path) -> None:
    path = recorded / f"robot{SUFFIX}"
    path.write_bytes(lines_of(path)[0])
    assert f"the recording ends at {path}:1: this run opens that wire" in replayed(recorded).stderr


def killed(folder: Path) -> Path:
    """Write a recording as a kill of its engine in a sweep has left it."""
    folder.mkdir()
    found = {name: list(read_recording(path)) for name, path in recordings(KEPT / KILLED).items()}
    answers = [each.t for each in found["tracker"] if each.e == "<"]
    ends_s = answers[-len(answers) // 8]  # in the stream of the last sweep
    for name, pieces in found.items():
        lines = [msgspec.json.encode(each) + b"\n" for each in pieces if each.t < ends_s]
        (folder / f"{name}{SUFFIX}").write_bytes(b"".join(lines))
    return folder


@pytest.mark.usefixtures("_nobody_answers")
def test_a_sweep_in_which_the_engine_was_killed(tmp_path: Path) -> None:
    """The robot's last state came again and again: HC-B31."""
    done = replayed(killed(tmp_path / "cut"), *PAIRS[KILLED], *sets(SMALL), run="axis-sweeps")
    assert done.returncode == 3
    assert fault(tmp_path / "replays" / "again")["code"] == ENDED
    assert any(f"/cut/{wire}{SUFFIX}:" in done.stderr for wire in ("robot", "tracker"))


@pytest.mark.process
def test_a_resumed_run_replays_by_resuming_its_replay(tmp_path: Path) -> None:
    points: list[str] = []

    def stop(event: dict[str, Any]) -> None:
        if event["kind"] == "point":
            points.append(event["key"])
            if len(points) == 2:
                os.kill(os.getpid(), signal.SIGTERM)

    words = ["--unattended", "--record-wire", "--json", "--runs", str(tmp_path)]
    first = command("run", "world-frame", *words, "--name", "first", hear=stop)
    assert first.returncode == 4
    assert command("resume", "first", *words).returncode == 0
    folder = tmp_path / "first"
    assert "name the run's own folder" in refused(folder / "wires-2", run="world-frame")
    assert replayed(folder, run="world-frame", runs=tmp_path).returncode == 3
    assert [row_of(tmp_path / name).replayed for name in ("first", "again")] == [False, True]
    assert fault(tmp_path / "again")["code"] == ENDED
    done = command("resume", "again", "--unattended", "--runs", tmp_path)
    assert done.returncode == 0, done.stderr
    again, once = (read_log(tmp_path / name).points for name in ("again", "first"))
    assert {key: at.xyz_mm for key, at in again.items()} == {
        key: at.xyz_mm for key, at in once.items()
    }
