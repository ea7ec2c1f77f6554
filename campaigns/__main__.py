"""``python -m campaigns [NAME...] [--count N] [--seed S]``: run campaigns, print their figures.

A campaign is a module with ``COUNT`` cases by default and ``campaign(seeds)``, which returns its
exit code: 0 where everything holds. A case is its seed, so one that failed is repeated by
``NAME --seed SEED --count 1``, and a campaign goes on where it stood by ``--seed``. Faults are
chosen by their own numbers, too: ``faults NUMBER... [--phase PHASE]``.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

from campaigns.faults import campaign as faults

CAMPAIGNS = {
    "faults": "campaigns.faults.campaign",
    "pairs": "campaigns.faults.pairs",
    "disturbances": "campaigns.disturbances",
    "kills": "campaigns.kills",
    "fuzz": "campaigns.fuzz.campaign",
    "days": "campaigns.days",
    "stops": "campaigns.stops",
    "rests": "campaigns.rests",
    "unknown": "campaigns.unknown",
    "traps": "campaigns.traps",
}


def main(words: list[str]) -> int:
    if words[:1] == ["faults"] and not {*CAMPAIGNS, "--count", "--seed"} & set(words[1:]):
        return faults.main(words[1:])
    parser = argparse.ArgumentParser("python -m campaigns")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(CAMPAIGNS))
    parser.add_argument("--count", type=int, help="cases; the campaign's own number by default")
    parser.add_argument("--seed", type=int, default=1, help="of the first case")
    args = parser.parse_args(words)
    if args.count is not None and args.count < 1:
        parser.error(f"--count: expected 1 or more, got {args.count}")
    if unknown := set(args.names) - set(CAMPAIGNS):
        parser.error(f"no campaign {', '.join(sorted(unknown))}; known: {', '.join(CAMPAIGNS)}")
    worst = 0
    for name in args.names or CAMPAIGNS:
        module = import_module(CAMPAIGNS[name])
        count = module.COUNT if args.count is None else args.count
        print(f"\n{name}: {count} cases from seed {args.seed}", flush=True)
        worst = max(worst, module.campaign(range(args.seed, args.seed + count)))
    return worst


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
