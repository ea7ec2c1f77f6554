"""A study on Kubernetes: ``python study_kubernetes.py STUDY.toml -o DIR --image IMAGE``.

The cluster has Dask's operator; the image has hilcell with its extra `study`, in this PC's
versions. A scheduler and workers are started there, the study is performed with them from here.
`--show` prints what would be created. Needs `pip install '.[study-kubernetes]'` in a clone here.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys


def main() -> int:
    """Return what `hilcell study` returns."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("study", help="the study file")
    parser.add_argument("-o", "--output", required=True, help="the folder of results")
    parser.add_argument("--image", required=True, help="an image with hilcell[study]")
    parser.add_argument("--workers", type=int, default=8, help="pods, a processor each")
    parser.add_argument("--namespace", default="default")
    parser.add_argument("--show", action="store_true", help="print the resource, and end")
    args = parser.parse_args()

    from dask_kubernetes.operator import KubeCluster, make_cluster_spec

    each = {"cpu": "1", "memory": "1Gi"}
    spec = make_cluster_spec(
        "hilcell-study",
        image=args.image,
        n_workers=args.workers,
        env={"OMP_NUM_THREADS": "1"},
        resources={"requests": each, "limits": each},
        worker_command="dask worker --nthreads 1",
    )
    (scheduler,) = spec["spec"]["scheduler"]["spec"]["containers"]
    scheduler["args"] = ["dask", "scheduler", "--host", "0.0.0.0"]  # noqa: S104 - a pod's own
    if args.show:
        print(json.dumps(spec, indent=2))
        return 0
    with KubeCluster(custom_cluster_spec=spec, namespace=args.namespace) as cluster:
        cluster.wait_for_workers(1)
        words = ["study", args.study, "-o", args.output, "--scheduler", cluster.scheduler_address]
        command = [sys.executable, "-m", "hilcell", *words]
        return subprocess.run(command, check=False).returncode  # noqa: S603 - words of this call


if __name__ == "__main__":
    sys.exit(main())
