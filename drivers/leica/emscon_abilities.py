"""Abilities of a Leica tracker behind emScon, from what it reports; facts of its TPI header."""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct
from typing import NamedTuple, Self

from drivers.leica.emscon import Reflector, SystemStatus, air_problem, utf_16_text
from drivers.tracker_readings import TrackerAbilities
from hilcell.ports import Ability
from hilcell.sanitize import clean


class TrackerInfo(NamedTuple):
    """The reply to GetTrackerInfo: type, name, distance meter, faces, and the range in mm."""

    sensor: int
    name: str
    has_adm: bool
    faces: int
    range_mm: tuple[float, float]

    @classmethod
    def decode(cls, body: bytes) -> Self:
        """Return the body of the reply; raises `struct.error`."""
        values = Struct("<I64s5i3d2i2dI2i").unpack_from(body)
        sensor, name, _serial, _compensation, adm, _camera, _level = values[:7]
        _mount_mm, most_mm, least_mm, _rate_hz, faces = values[7:12]
        return cls(sensor, clean(utf_16_text(name)), bool(adm), faces, (least_mm, most_mm))


class Reported(NamedTuple):
    """All that a tracker reports; None where the controller does not know the question."""

    status: SystemStatus
    info: TrackerInfo | None
    reflectors: Sequence[Reflector]
    air: tuple[float, float, float]
    face: int | None
    tells_direction: bool
    streams: bool


def abilities(reported: Reported, reflector: str, serial: str) -> list[Ability]:
    """Return what the driver needs; reflector and serial number are the cell file's, "" for any."""
    status, info = reported.status, reported.info
    found = TrackerAbilities()
    expected = f"; the cell file has {serial}" if serial not in ("", str(status.serial)) else ""
    found.need("serial number", status.serial != 0 and not expected, f"{status.serial}{expected}")
    found.need("emScon TPI", True, f"version {status.version}")
    if info is None:
        found.may("type", False, "GetTrackerInfo is unknown to this controller; read its plate")
    else:
        found.need("sensor", info.sensor != SystemStatus.NO_SENSOR, info.name)
        found.need("ADM (absolute distances)", info.has_adm, "")
    initialised = status.processor == SystemStatus.INITIALIZED
    note = "" if initialised else "connecting initialises it: the head turns"
    found.may("initialised", initialised, note)
    warm = status.laser == SystemStatus.LASER_READY and status.adm == SystemStatus.ADM_READY
    states = f"laser status {status.laser}, ADM status {status.adm}"
    found.need("laser and ADM ready (warmed up)", warm, "" if warm else states)
    weather = status.weather_monitor == SystemStatus.AIR_MEASURED
    values = "{:.1f} C, {:.1f} mbar, {:.0f} %".format(*reported.air)
    entered = f"values entered by hand are used: {values}"
    found.may("weather station corrects distances", weather, values if weather else entered)
    if problem := air_problem(*reported.air):
        found.need("values that air can have", False, problem)
    known = {clean(each.name): each.offset_mm for each in reported.reflectors}
    for name, offset in known.items():
        found.may(f"reflector {name!r}", True, f"offset {offset:g} in the tracker's units")
    if reflector and reflector not in known:
        found.need(f"reflector {reflector!r}", False, "define it in the tracker")
    turns = reported.face is not None and (info is None or info.faces > 1)
    found.may("second face", turns, "" if turns else "errors of its axes are not seen")
    streams = "" if reported.streams else "no axis sweeps: gear ripple remains"
    found.may("continuous time mode", reported.streams, streams)
    tells = "" if reported.tells_direction else "a failed search does not say where it looked"
    found.may("GetDirection", reported.tells_direction, tells)
    return found.listed
