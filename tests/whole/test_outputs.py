"""Commands that are done at once in one process have outputs of their own."""

import sys
from concurrent.futures import ThreadPoolExecutor
from io import StringIO

from tests.whole.outputs import Outputs


def test_each_thread_writes_to_its_own_and_a_worker_to_the_first() -> None:
    outputs, before = Outputs(), (sys.stdout, sys.stderr)
    run, order, err = StringIO(), StringIO(), StringIO()
    with ThreadPoolExecutor(1) as worker, ThreadPoolExecutor(1) as beside:
        first = outputs.to(run, err)
        first.__enter__()
        try:
            other = outputs.to(order, err)
            beside.submit(other.__enter__).result()
            print("run")
            beside.submit(print, "order").result()
            worker.submit(print, "worker").result()
        finally:
            first.__exit__(None, None, None)
        beside.submit(print, "order, later").result()
        beside.submit(other.__exit__, None, None, None).result()
    assert run.getvalue() == "run\nworker\n"
    assert order.getvalue() == "order\norder, later\n"
    assert (sys.stdout, sys.stderr) == before
