"""Two real runs compared; and runs altered by a known amount, which must be reported."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.frames import world_covariance
from hilcell.errors import HilcellError
from hilcell.geometry.frames import apply, inverse, pose_from_zyx, three_point_frame
from hilcell.geometry.statistics import Figures
from hilcell.journal.journal import Journal, Record, StorageError, read_journal
from hilcell.journal.log import Log, positions_mm
from hilcell.journal.runs import JOURNAL
from hilcell.report.comparison import Change, Comparison, Setting, compare_runs, length_factor
from hilcell.run.control import Control
from tests.hilcell.report.journals import Writer
from tests.hilcell.run.test_control import Recorder
from tests.hilcell.run.test_in_process import performed
from tests.whole.bench import SMALL, command
from tests.whole.golden import GoldenRuns

Change_ = Callable[[Record], Record | None]


@pytest.fixture(scope="module")
def pair(golden: GoldenRuns) -> tuple[Path, Path]:
    """Return the folders of two small calibrations of different seeds."""
    return golden["small"].folder, golden["small-2"].folder


@pytest.fixture(scope="module")
def records(pair: tuple[Path, Path]) -> list[Record]:
    return read_journal(pair[0] / JOURNAL)


@pytest.fixture(scope="module")
def first(records: list[Record]) -> Log:
    return Log(records)


@pytest.fixture(scope="module")
def seeds(pair: tuple[Path, Path], first: Log) -> Comparison:
    """Return the comparison of both."""
    return compare_runs(first, Log(read_journal(pair[1] / JOURNAL)))


def kind_of(record: Record) -> str:
    """Return the kind of a point; "" for other records."""
    return str(record.body["id"]["kind"]) if record.kind == "point" else ""


def altered(records: list[Record], change: Change_, kind: str = "", key: str = "") -> Log:
    """Return the log of a run whose records, of a kind and a key, were changed or left out."""
    kept = (
        change(each) if kind in ("", each.kind) and key in ("", each.key) else each
        for each in records
    )
    return Log(record for record in kept if record is not None)


def plan_with(records: list[Record], change: Callable[[dict[str, Any]], object]) -> Log:
    """Return the log of a run with other frozen inputs."""

    def act(record: Record) -> Record:
        body = json.loads(json.dumps(record.body))
        change(body)
        return msgspec.structs.replace(record, body=body)

    return altered(records, act, "plan")


def body_with(record: Record, **values: Any) -> Record:
    plain = msgspec.to_builtins(values, enc_hook=lambda array: array.tolist())
    return msgspec.structs.replace(record, body=record.body | plain)


def of(found: Comparison, group: str, what: str = "", place: str = "") -> list[Change]:
    own = [each for each in found.changes if each.group == group]
    return [each for each in own if what in each.what and place in each.place]


# -- real runs ------------------------------------------------------------------------------------


def test_two_simulated_cells(seeds: Comparison) -> None:
    """Different seeds are different floors, rails and arms: the comparison sees it all."""
    assert seeds.settings == [Setting("seed", "1", "2"), Setting("machine_seed", "1", "2")]
    assert seeds.notes
    frames = of(seeds, "frames")
    stations = {f"station {name}" for name in ("S300", "S1100", "S1900")}
    assert {each.place for each in frames} == {"base", *stations}
    assert all(each.verdict == "beyond" for each in frames)
    assert [each.verdict for each in of(seeds, "grid", "move")] == ["beyond"] * 3
    assert seeds.drifted
    moved_mm = [*seeds.moved_mm.values()]
    assert len(moved_mm) == 27
    assert of(seeds, "grid", "largest")[0].change == max(moved_mm)
    assert of(seeds, "grid", "mean move")[0].change == pytest.approx(np.mean(moved_mm))


def test_figures_are_those_of_both_results(seeds: Comparison, pair: tuple[Path, Path]) -> None:
    results = [Log(read_journal(folder / JOURNAL)).end for folder in pair]
    changes = of(seeds, "validation")
    assert {each.place for each in changes} == {"S1100", "others", "S300", "S1900"}
    assert len(changes) == 4 * 3 * len(Figures._fields)
    for each in changes:
        how, what = each.what.split()
        one, two = (end.result["validation"][each.place][how][what] for end in results if end)
        assert [each.first, each.second] == pytest.approx([one, two])
        assert each.change == pytest.approx(two - one)
        assert (each.limit is not None) == (what == "mean")


def test_an_uncertain_base_widens_the_limit_before_a_correction_alone(
    first: Log, records: list[Record]
) -> None:
    """A correction that was learnt in a run's {B} makes up for where that {B} is."""

    def uncertain(record: Record) -> Record:
        return body_with(record, covariance=100.0 * np.array(record.body["covariance"]))

    doubted = altered(records, uncertain, "frame", "base")
    known, widened = (
        {(each.place, each.what): each.limit or 0.0 for each in of(found, "validation", " mean")}
        for found in (compare_runs(first, first), compare_runs(first, doubted))
    )
    assert all(known.values())
    for (place, what), limit in known.items():
        assert (widened[place, what] > 1.01 * limit) == what.startswith("before"), (place, what)


def test_a_run_is_as_itself(first: Log, records: list[Record]) -> None:
    found = compare_runs(first, Log(records))
    assert found.settings == []
    assert all(each.change == pytest.approx(0.0, abs=1e-9) for each in found.changes)
    assert found.drifted == []
    assert len(found.notes) == 1
    assert found.verdict.startswith("no drift: all ")
    under_way = compare_runs(first, Log(records[: -len(records) // 10]), live=(False, True))
    assert under_way.unfinished
    assert under_way.verdict.startswith("no drift so far: all ")


def test_without_a_rail_the_base_alone_is_compared(golden: GoldenRuns) -> None:
    log = Log(read_journal(golden["seats"].folder / JOURNAL))
    found = compare_runs(log, log)
    assert [each.place for each in of(found, "frames")] == ["base", "base"]
    assert all(each.limit for each in of(found, "frames"))
    assert found.drifted == []


def test_the_same_cell_measured_otherwise_has_not_drifted(first: Log, tmp_path: Path) -> None:
    """Other readings of nests and circles: another noise, the same truth, nothing is beyond."""
    words = SMALL | {"layout.nest_samples": "3", "base_frame.points": "7"}
    found = compare_runs(first, performed(tmp_path, words))
    assert {each.key: (each.first, each.second) for each in found.settings} == {
        "layout.nest_samples": ("2", "3"),
        "base_frame.points": ("6", "7"),
        "unattended": ("false", "true"),  # nobody attends a run without wires
    }
    assert found.drifted == []
    assert any(each.change != 0.0 for each in of(found, "frames"))


# -- known changes --------------------------------------------------------------------------------


def test_another_set_up_of_the_tracker_changes_nothing(first: Log, records: list[Record]) -> None:
    M = pose_from_zyx(420.0, -310.0, 55.0, 25.0, 0.4, -0.3)  # the new tracker frame in the old

    def set_up(record: Record) -> Record:
        if record.kind == "point":
            return body_with(record, xyz_mm=apply(inverse(M), [record.body["xyz_mm"]])[0])
        if record.kind == "frame" and record.key == "world":
            return body_with(record, matrix=np.array(record.body["matrix"]) @ M)
        return record

    found = compare_runs(first, altered(records, set_up))
    assert all(abs(each.change) <= 1e-8 for each in found.changes)
    assert found.drifted == []


def test_one_vertex_is_found_and_named(first: Log, records: list[Record]) -> None:
    def shift(record: Record) -> Record:
        return body_with(record, xyz_mm=np.add(record.body["xyz_mm"], (3.0, 4.0, 0.0)))

    found = compare_runs(first, altered(records, shift, "point", "grid/1-2-0"))
    (largest,) = of(found, "grid", "largest")
    assert (largest.place, largest.verdict) == ("grid/1-2-0", "beyond")
    assert largest.change == pytest.approx(5.0, abs=1e-6)
    assert found.moved_mm.pop("grid/1-2-0") == pytest.approx(5.0, abs=1e-6)
    assert max(found.moved_mm.values()) <= 1e-6
    assert largest in found.drifted
    assert {each.group for each in found.drifted} == {"grid"}


def test_what_moves_all_vertices_is_not_the_arms(first: Log, records: list[Record]) -> None:
    turned = pose_from_zyx(0.9, -1.2, 0.0, 0.0, 0.0, 0.02)
    other_base = first.matrix("base") @ turned
    in_world = other_base @ inverse(first.matrix("base"))

    def shift(record: Record) -> Record:
        if record.kind == "frame" and record.key == "base":
            return body_with(record, matrix=other_base)
        if kind_of(record) == "grid":
            nominal_mm = apply(in_world, [record.body["nominal_mm"]])[0]
            return body_with(record, nominal_mm=nominal_mm)
        return record

    found = compare_runs(first, altered(records, shift))
    whole, own = of(found, "grid", "mean move")
    assert whole.change > 1.0
    assert own.change < 0.001
    assert own.verdict == "within"
    moved, turn = of(found, "frames", place="base")
    assert moved.change == pytest.approx(1.5, abs=1e-9)
    assert turn.change == pytest.approx(0.02, abs=1e-9)


@pytest.mark.parametrize("deg", [1e-6, 0.3, 90.0, 179.0])
def test_a_station_that_moved_and_turned(first: Log, records: list[Record], deg: float) -> None:
    def shift(record: Record) -> Record:
        T = np.array(record.body["matrix"]) @ pose_from_zyx(0.0, 0.0, 0.0, deg, 0.0, 0.0)
        T[:3, 3] += (0.2, 0.0, -0.1)
        return body_with(record, matrix=T)

    found = compare_runs(first, altered(records, shift, "frame", "station.S300"))
    moved, turn = of(found, "frames", place="station S300")
    assert moved.change == pytest.approx(np.hypot(0.2, 0.1))
    assert turn.change == pytest.approx(deg, rel=1e-6)
    assert moved in found.drifted
    others = [each for each in of(found, "frames") if each.place != "station S300"]
    assert [each.change for each in others] == pytest.approx([0.0] * len(others), abs=1e-9)


def test_warm_air_is_a_reason_and_not_a_drift(first: Log, records: list[Record]) -> None:
    def warm(record: Record) -> Record:
        return body_with(record, temperature_c=record.body["temperature_c"] + 2.5)

    found = compare_runs(first, altered(records, warm, "point"))
    (air,) = of(found, "air")
    assert [air.change, air.limit] == pytest.approx([2.5, 2.0])
    assert air.verdict == "beyond"
    assert found.drifted == []


# -- settings and notes ---------------------------------------------------------------------------


def test_settings_are_compared_key_by_key(first: Log, records: list[Record]) -> None:
    def change(plan: dict[str, Any]) -> None:
        cell = plan["cell"]
        cell["rail"]["strip_tolerance_mm"] = 0.02
        cell["rail"]["options"]["port"] = 7
        cell["station"] = [
            s | {"strip_mm": 300.01} if s["name"] == "S300" else s
            for s in reversed(cell["station"])
        ]
        cell["robot"]["joint"][2]["d_mm"] = -1.0
        cell["layout"]["slide"][0]["name"] = "P9"
        cell["simulation"]["address"] = "127.0.0.1:9"
        plan["machine_seed"] = None
        plan["versions"]["hilcell"] = "9.9.9"

    found = {
        each.key: (each.first, each.second)
        for each in compare_runs(first, plan_with(records, change)).settings
    }
    assert found.pop("rail.strip_tolerance_mm") == ("0.01", "0.02")
    assert found.pop("rail.options.port") == ("", "7")
    assert found.pop("station[S300].strip_mm")[1] == "300.01"
    assert found.pop("robot.joint[3].d_mm")[1] == "-1.0"
    assert found.pop("versions.hilcell")[1] == "9.9.9"
    assert found.pop("machine_seed")[1] == ""  # of a cell that ran already
    slide = first.cell.layout.slide[0].name
    assert {key.split(".")[1].split("[")[1][:-1] for key in found} == {slide, "P9"}
    assert all("" in pair for pair in found.values())


def test_other_grids_are_not_compared(first: Log, records: list[Record]) -> None:
    other = plan_with(records, lambda plan: plan["cell"]["grid"]["centre"].update(x_mm=1800.0))
    found = compare_runs(first, other)
    assert of(found, "grid") == []
    assert found.moved_mm == {}


def test_an_unfinished_run_is_compared_as_far_as_it_is(first: Log, records: list[Record]) -> None:
    framed = next(n for n, r in enumerate(records) if r.key == "station.S300")
    cut = Log(records[: framed + 1])
    for live in (True, False):
        notes = " ".join(compare_runs(first, cut, live=(False, live)).notes)
        assert "second run" in notes
        assert ("engine" in notes) is not live
    found = compare_runs(first, cut)
    assert of(found, "validation") == []
    assert {each.place for each in of(found, "frames")} == {"base", "station S1100", "station S300"}
    half = compare_runs(first, Log(r for r in records if r.key not in ("grid/0-0-0", "grid/2-2-2")))
    assert len(half.moved_mm) == 25
    assert half.drifted == []


def test_without_floor_nests_no_frame_is_judged(first: Log, records: list[Record]) -> None:
    nest = f"world/{first.cell.layout.floor[1].name}"
    found = compare_runs(first, altered(records, lambda _: None, key=nest))
    assert all(each.verdict == "" for each in of(found, "frames"))


# -- refusals -------------------------------------------------------------------------------------


def test_other_cells_are_refused(first: Log, records: list[Record]) -> None:
    other = plan_with(records, lambda plan: plan["cell"].update(serial="another"))
    with pytest.raises(HilcellError, match="another"):
        compare_runs(first, other)
    machines = [record for record in records if record.body.get("what") != "connected"]
    real = plan_with(machines, lambda plan: plan.update(simulated=False))
    for one, two in ((first, real), (real, first)):
        with pytest.raises(HilcellError, match="simulated"):
            compare_runs(one, two)


def test_runs_without_anything_in_common_are_refused(first: Log, tmp_path: Path) -> None:
    cell = msgspec.to_builtins(first.cell)
    home = Writer(tmp_path / "home", cell=cell).began().ended()
    log = Log(read_journal(home / JOURNAL))
    with pytest.raises(HilcellError, match="home"):
        compare_runs(first, log)
    with pytest.raises(HilcellError):
        compare_runs(log, log)
    with pytest.raises(StorageError):
        compare_runs(first, Log())


@pytest.mark.parametrize("turned", [False, True])
def test_a_run_without_a_grid_beside_a_calibration(
    first: Log, records: list[Record], turned: bool
) -> None:
    """As re-checks and touches are."""
    framed = altered(records, lambda each: None if kind_of(each) == "grid" else each)
    found = compare_runs(framed, first) if turned else compare_runs(first, framed)
    assert of(found, "grid") == []
    assert {each.place for each in of(found, "frames")} >= {"base", "station S1100"}
    assert of(compare_runs(framed, framed), "frames")


# -- limits ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 27, 64])
def test_limits_hold_for_95_of_100_lengths(count: int) -> None:
    lengths = np.linalg.norm(np.random.default_rng(5).normal(size=(20_000, count, 3)), axis=2)
    share = np.mean(lengths.max(axis=1) <= length_factor(count))
    assert share == pytest.approx(0.95, abs=0.006)


def test_the_worlds_noise_is_what_chance_makes_of_it(
    first: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(3)
    floor = [first.points[f"world/{nest.name}"] for nest in first.cell.layout.floor[:3]]
    std_mm = (0.02, 0.05, 0.03)
    floor = [msgspec.structs.replace(each, std_mm=std_mm, samples=4) for each in floor]
    for each in floor:
        monkeypatch.setitem(first.points, each.key, each)
    T_W_L, at_mm = first.matrix("world"), first.matrix("station.S1900")[:3, 3]
    seen_mm = apply(inverse(T_W_L), at_mm[None])
    measured_mm = positions_mm(floor)
    moves = []
    for _ in range(2000):
        other_mm = measured_mm + rng.normal(size=(3, 3)) * np.array(std_mm) / 2
        T = T_W_L @ three_point_frame(*measured_mm) @ inverse(three_point_frame(*other_mm))
        R = T[:3, :3] @ T_W_L[:3, :3].T
        moves.append([*(apply(T, seen_mm)[0] - at_mm), R[2, 1], R[0, 2], R[1, 0]])
    predicted = world_covariance(first, at_mm)
    scale = np.sqrt(np.diag(predicted))
    found = np.cov(np.array(moves).T) / np.outer(scale, scale)
    assert np.allclose(found, predicted / np.outer(scale, scale), atol=0.1)


@pytest.mark.parametrize(
    ("change", "verdict"),
    [(1.0, "within"), (-1.0, "within"), (1.1, "beyond"), (-1.1, "beyond"), (np.nan, "beyond")],
)
def test_a_change_keeps_its_limit_to_both_sides(change: float, verdict: str) -> None:
    assert Change("grid", "", "", "mm", None, None, change, 1.0).verdict == verdict


# -- the command ----------------------------------------------------------------------------------


def compared(pair: tuple[Path, Path], *words: str) -> subprocess.CompletedProcess[str]:
    done = command("compare", *pair, "--runs", pair[1].parent, *words)
    assert done.returncode == 0, done.stderr
    return done


def test_the_command(pair: tuple[Path, Path], seeds: Comparison) -> None:
    found = json.loads(compared(pair, "--json").stdout)
    assert list(found) == [
        "first", "second", "verdict", "settings", "changes", "moved_mm", "notes", "unfinished",
    ]  # fmt: skip
    assert (found["first"], found["second"]) == (pair[0].name, pair[1].name)
    assert len(found["changes"]) == len(seeds.changes)
    assert found["changes"][0]["verdict"] == seeds.changes[0].verdict
    names = [(each["where"], each["figure"]) for each in found["changes"]]
    assert len(set(names)) == len(names)  # no row stands for two
    assert {"S300 frame", "S1900 frame", "S300 targets", "robot base"} < {name for name, _ in names}
    done = compared(pair)
    assert "S1900 frame" in done.stdout
    assert seeds.verdict in done.stderr
    assert all(note in done.stderr for note in seeds.notes)


def test_the_command_says_whose_engine_is_gone(
    pair: tuple[Path, Path], records: list[Record], tmp_path: Path
) -> None:
    cut = tmp_path / "cut"
    cut.mkdir()
    journal = Journal(cut / JOURNAL, "cut", create=True)
    for record in records[: next(n for n, r in enumerate(records) if r.key == "station.S300")]:
        journal.append(record.kind, record.key, record.body)
    journal.close()
    assert "engine" in compared((pair[0], cut)).stderr
    control = Control(cut, Recorder())
    said = compared((pair[0], cut)).stderr
    control.close()
    assert "engine" not in said
    assert "running" in said
