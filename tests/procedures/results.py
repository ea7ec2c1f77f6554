"""The results of single acts, as their JSON."""

import msgspec

from hilcell.decoding import Json
from hilcell.journal.log import Log
from hilcell.run.procedure import Step


def result_of(act: Step, log: Log) -> Json:
    found: Json = msgspec.to_builtins(act.result(log))
    return found
