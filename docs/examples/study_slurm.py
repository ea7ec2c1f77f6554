"""A study on a cluster that SLURM manages: ``python study_slurm.py STUDY.toml -o DIR --jobs 16``.

Run it where jobs are submitted. It starts a scheduler here, asks SLURM for jobs of workers, and
performs the study with them. `--show` prints the script of a job and submits nothing.
Needs `pip install '.[study-slurm]'` in a clone here and on the nodes.
"""

from __future__ import annotations

import argparse
import subprocess
import sys


def main() -> int:
    """Return what `hilcell study` returns."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("study", help="the study file")
    parser.add_argument("-o", "--output", required=True, help="the folder of results")
    parser.add_argument("--jobs", type=int, default=4, help="jobs of SLURM")
    parser.add_argument("--workers", type=int, default=8, help="workers of a job, a core each")
    parser.add_argument("--queue", help="SLURM's partition")
    parser.add_argument("--account")
    parser.add_argument("--walltime", default="04:00:00")
    parser.add_argument("--interface", help="the network that nodes and this PC share: ib0, eth0")
    parser.add_argument("--show", action="store_true", help="print the script of a job, and end")
    args = parser.parse_args()

    from dask_jobqueue import SLURMCluster

    with SLURMCluster(
        queue=args.queue,
        account=args.account,
        walltime=args.walltime,
        interface=args.interface,
        cores=args.workers,
        processes=args.workers,  # as many as cores: one thread each
        memory=f"{args.workers} GB",
        job_script_prologue=["export OMP_NUM_THREADS=1"],
    ) as cluster:
        if args.show:
            print(cluster.job_script())
            return 0
        cluster.scale(jobs=args.jobs)
        cluster.wait_for_workers(1)  # however long the queue is
        words = ["study", args.study, "-o", args.output, "--scheduler", cluster.scheduler_address]
        command = [sys.executable, "-m", "hilcell", *words]
        return subprocess.run(command, check=False).returncode  # noqa: S603 - words of this call


if __name__ == "__main__":
    sys.exit(main())
