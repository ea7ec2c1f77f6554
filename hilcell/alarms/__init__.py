"""Alarms: the faults and warnings of a run, their meaning, their place, and the steps to take."""

from hilcell.alarms.alarm import Alarm, alarms_of
from hilcell.alarms.catalogue import Entry, Severity, catalogue
from hilcell.alarms.latch import Latch, Latched

__all__ = [
    "Alarm",
    "Entry",
    "Latch",
    "Latched",
    "Severity",
    "alarms_of",
    "catalogue",
]
