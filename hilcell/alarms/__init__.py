"""Alarms: what a run's faults and oddities mean, where they are, and what to do about them."""

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
