"""The shipped scripts that start clusters for studies; their packages are no part of a clone's."""

from __future__ import annotations

import json
import runpy
import sys

import pytest

NOT_INSTALLED = "a cluster's package, which `make test` does not install"


def script(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: str
) -> str:
    monkeypatch.setattr(sys, "argv", [name, *words.split()])
    with pytest.raises(SystemExit, match="0"):
        runpy.run_path(f"docs/examples/{name}.py", run_name="__main__")
    return capsys.readouterr().out


@pytest.mark.parametrize("name", ["study_slurm", "study_kubernetes"])
def test_its_help_names_its_options(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "--workers" in script(name, monkeypatch, capsys, "--help")


def test_a_job_of_slurm(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("dask_jobqueue", reason=NOT_INSTALLED)
    words = "s.toml -o r --queue short --workers 6 --show"
    job = script("study_slurm", monkeypatch, capsys, words)
    for line in ("#SBATCH -p short", "#SBATCH --cpus-per-task=6", "export OMP_NUM_THREADS=1"):
        assert line in job.splitlines()
    assert "--nthreads 1" in job
    assert "--nworkers 6" in job


def test_a_resource_of_kubernetes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("dask_kubernetes", reason=NOT_INSTALLED)
    words = "s.toml -o r --image lab/hilcell --workers 3 --show"
    spec = json.loads(script("study_kubernetes", monkeypatch, capsys, words))["spec"]
    assert spec["worker"]["replicas"] == 3
    (worker,) = spec["worker"]["spec"]["containers"]
    (scheduler,) = spec["scheduler"]["spec"]["containers"]
    assert worker["args"][:4] == ["dask", "worker", "--nthreads", "1"]
    assert scheduler["args"][:2] == ["dask", "scheduler"]
    assert {"name": "OMP_NUM_THREADS", "value": "1"} in worker["env"]
    assert worker["image"] == scheduler["image"] == "lab/hilcell"
