"""The shipped scripts that start clusters for studies; their packages are no part of a clone's."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.hilcell.study.studies import TWO_FACTORS, written

EXAMPLES = Path("docs/examples").resolve()
READINGS = TWO_FACTORS.partition('\n[[factor]]\nname = "place"')[0]
NOT_INSTALLED = "a cluster's package, which `make test` does not install"
SBATCH = """#!/bin/sh
sh "$1" > job.out 2>&1 &
echo "Submitted batch job 1"
"""


def script(
    name: str, *words: str | Path, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    path = f"{folder}:{os.environ['PATH']}" if folder else os.environ["PATH"]
    return subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py"), *map(str, words)],
        capture_output=True, text=True, timeout=120, check=False, cwd=folder,
        env=os.environ | {"PATH": path},
    )  # fmt: skip


@pytest.mark.parametrize("name", ["study_slurm", "study_kubernetes"])
def test_it_says_how_it_is_used(name: str) -> None:
    done = script(name, "--help")
    assert done.returncode == 0
    assert "the study file" in done.stdout


def test_a_job_of_slurm() -> None:
    pytest.importorskip("dask_jobqueue", reason=NOT_INSTALLED)
    words = ("s.toml", "-o", "r", "--queue", "short", "--workers", "6", "--show")
    job = script("study_slurm", *words).stdout
    for line in ("#SBATCH -p short", "#SBATCH --cpus-per-task=6", "export OMP_NUM_THREADS=1"):
        assert line in job.splitlines()
    assert "--nthreads 1" in job
    assert "--nworkers 6" in job


@pytest.mark.nightly
def test_a_study_by_jobs_of_slurm(tmp_path: Path) -> None:
    """Its `sbatch` is a stand-in that begins the job's script at once, on this PC."""
    pytest.importorskip("dask_jobqueue", reason=NOT_INSTALLED)
    for name, text in (("sbatch", SBATCH), ("scancel", "#!/bin/sh\n")):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    path = written(tmp_path, READINGS)
    words = (path, "-o", tmp_path / "r", "--jobs", "1", "--workers", "2", "--interface", "lo")
    done = script("study_slurm", *words, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert pq.read_table(tmp_path / "r/cases")["state"].to_pylist() == ["done"] * 4


def test_a_resource_of_kubernetes() -> None:
    pytest.importorskip("dask_kubernetes", reason=NOT_INSTALLED)
    words = ("s.toml", "-o", "r", "--image", "lab/hilcell", "--workers", "3", "--show")
    spec = json.loads(script("study_kubernetes", *words).stdout)["spec"]
    assert spec["worker"]["replicas"] == 3
    (worker,) = spec["worker"]["spec"]["containers"]
    (scheduler,) = spec["scheduler"]["spec"]["containers"]
    assert worker["args"][:4] == ["dask", "worker", "--nthreads", "1"]
    assert scheduler["args"][:2] == ["dask", "scheduler"]
    assert {"name": "OMP_NUM_THREADS", "value": "1"} in worker["env"]
    assert worker["image"] == scheduler["image"] == "lab/hilcell"
