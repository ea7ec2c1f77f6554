"""Alarms: the faults and warnings of a run, their meaning, their place, and the steps to take."""

from hilcell.alarms.alarm import Alarm, Latch, Latched, alarms_of
from hilcell.alarms.catalogue import Entry, Severity, catalogue

__all__ = ["Alarm", "Entry", "Latch", "Latched", "Severity", "alarms_of", "catalogue"]
