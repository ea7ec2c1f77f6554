"""``python -m benchmarks.forecast``: how far the forecast is off while a run is under way.

A run is made at a stated speed; its journal is then taken record by record, as a screen takes it,
and what was said at, between and just before the records is compared with what the run took.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import datetime
from itertools import pairwise
from pathlib import Path

from benchmarks.words import parser
from hilcell.journal.journal import Record, read_journal
from hilcell.run.forecast import Forecast

TENTH = 0.1


def forecasts(records: list[Record]) -> Iterator[tuple[float, float]]:
    """Yield (share of the run's time, relative error of its total), moment by moment."""
    whole, forecast = Forecast(), Forecast()
    for record in records:
        whole.take(record)
    took_s = whole.elapsed_s(moment(records[-1]))
    for record, following in pairwise(records):
        forecast.take(record)
        gap = moment(following) - moment(record)
        for share in (0.0, 0.5, 1.0):
            now = moment(record) + share * gap
            worked_s, left_s = forecast.elapsed_s(now), forecast.remaining_s(now)
            error = float("inf") if left_s is None else (worked_s + left_s) / took_s - 1.0
            yield worked_s / took_s, error


def worst_after(begin: float, records: list[Record]) -> float:
    """Return the error of the largest size after a share of the run's time."""
    return max((error for share, error in forecasts(records) if share >= begin), key=abs)


def moment(record: Record) -> datetime:
    return datetime.fromisoformat(record.t)


def main() -> None:
    words = parser(__doc__)
    words.add_argument("procedure", nargs="?", default="calibrate")
    words.add_argument("--speed", default="60")
    words.add_argument("--seed", default="7")
    args = words.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "hilcell", "run", args.procedure, "--unattended", "--json",
             "--speed", args.speed, "--seed", args.seed, "--runs", folder],
            check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        (journal,) = Path(folder).glob("*/journal.sqlite")
        records = read_journal(journal)
    worst = worst_after(TENTH, records)
    print(
        f"{args.procedure} at speed {args.speed}, seed {args.seed}: total within "
        f"{abs(worst):.1%} after a tenth of the run (worst {worst:+.1%})"
    )


if __name__ == "__main__":
    main()
