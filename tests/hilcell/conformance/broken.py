"""Drivers broken on purpose: each breaks one promise of its port, and keeps all others."""

from __future__ import annotations

import os
import tempfile
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from hilcell.errors import DeviceError, DeviceRefused, Stopped
from tests.hilcell.conformance.seams import (
    Call,
    Seams,
    replaced,
)

LIMIT_S = 0.1
GOOD_VISITS = 4
TORN, LATELY = 3, 9  # receptions of one byte, among the last ones


class Base(Seams):
    """What the breaks of every port use, for their types alone."""

    def __init__(self, options: Any, clock: Any) -> None:
        self.visits = 0
        self.missed = self.stopped = self.connecting = self.was_closed = False
        self.options = options
        super().__init__(options, clock)  # type: ignore[call-arg]  # of the driver beside it

    def connect(self) -> Any:
        self.connecting = True
        try:
            found = super().connect()  # type: ignore[misc]  # of the driver beside it
        finally:
            self.connecting = False
        self.missed = self.stopped = self.was_closed = False
        return found

    def stop(self) -> None:
        super().stop()  # type: ignore[misc]  # of the driver beside it

    def close(self) -> None:
        super().close()  # type: ignore[misc]  # of the driver beside it


class IdentitySame(Base):
    connects = 0

    def connect(self) -> Any:
        type(self).connects += 1
        return [replace(each, serial=f"{each.serial}{self.connects}") for each in super().connect()]


class IdentityClean(Base):
    def connect(self) -> Any:
        return [replace(each, model=f"{each.model}\x1b[2J") for each in super().connect()]


class IdentityWrong(Base):
    def __init__(self, options: Any, clock: Any) -> None:
        serials = [key for key in options.__struct_fields__ if key.endswith("serial")]
        anyone = {key: type(getattr(options, key))() for key in serials}
        super().__init__(msgspec.structs.replace(options, **anyone), clock)


class Unreachable(Base):
    def connect(self) -> Any:
        try:
            return super().connect()
        except DeviceError as error:
            if "Connection refused" in error.found:
                raise ConnectionRefusedError(error.found) from error
            raise


class NotConnected(Base):
    def asked(self, call: Call) -> Any:
        if not (self.up or self.failed):
            raise AttributeError("'NoneType' object has no attribute 'send'")
        return super().asked(call)


class ConnectTwice(Base):
    def connect(self) -> Any:
        if self.up and not self.failed:
            raise DeviceRefused("HC-C99", "Device", "connect", "connected already")
        return super().connect()


class CloseTwice(Base):
    def close(self) -> None:
        if self.was_closed and not self.connecting:
            raise RuntimeError("closed already")
        self.was_closed = self.up
        super().close()


class StopTwice(Base):
    def stop(self) -> None:
        if self.was_closed:
            raise DeviceError("HC-C99", "Device", "stop", "not connected")
        super().stop()

    def close(self) -> None:
        super().close()
        self.was_closed = True


class Taken(Base):
    def asked(self, call: Call) -> Any:
        reading = super().asked(call)
        return replaced(reading, taken_s=reading.taken_s + 10.0)


class NoNumber(Base):
    takes_anything = True


class ReadsBack(Base):
    good_visits = GOOD_VISITS

    def visited(self, call: Call) -> Any:
        reading = super().visited(call)
        self.visits += 1
        return self.shifted(reading) if self.visits > self.good_visits else reading


class AtRest(Base):
    def asked(self, call: Call) -> Any:
        return replaced(super().asked(call), still=False)


class Ended(Base):
    def asked(self, call: Call) -> Any:
        return replaced(super().asked(call), ended_s=None)


class Silent(Base):
    def asked(self, call: Call) -> Any:
        try:
            return super().asked(call)
        except DeviceError as error:
            if self.cause(error) == "silent" and self.last is not None:
                return self.last
            raise


class Late(Base):
    def asked(self, call: Call) -> Any:
        if self.missed:
            return self.last
        try:
            return super().asked(call)
        except DeviceError as error:
            self.missed = self.cause(error) == "silent"
            raise

    def visited(self, call: Call) -> Any:
        return self.last if self.missed else super().visited(call)

    def moved(self, call: Call) -> Any:
        return None if self.missed else super().moved(call)


class Slow(Base):
    def asked(self, call: Call) -> Any:
        began_s = time.monotonic()
        reading = super().asked(call)
        if time.monotonic() - began_s > LIMIT_S:
            raise DeviceError("HC-C99", "Device", "read", "too slow")
        return reading


class Pieces(Base):
    def connect(self) -> Any:
        found = super().connect()
        self.sizes = deque[int](maxlen=LATELY)
        self.patch()
        return found

    def patch(self) -> None:
        raise NotImplementedError

    def whole(self, data: bytes) -> bytes:
        if self.torn(data):
            raise DeviceError("HC-C99", "Device", "receive", "answers of one byte")
        return data

    def torn(self, data: bytes) -> bool:
        """Whether one byte came alone again and again; once it does on any wire."""
        if data:
            self.sizes.append(len(data))
        return self.sizes.count(1) >= TORN


class Garbage(Base):
    def asked(self, call: Call) -> Any:
        try:
            return super().asked(call)
        except DeviceError as error:
            if self.cause(error) == "noise":
                raise ValueError(error.found) from error
            raise


class DeviceKilled(Base):
    def asked(self, call: Call) -> Any:
        try:
            return super().asked(call)
        except DeviceError as error:
            if self.cause(error) == "cut":
                raise ConnectionResetError(error.found) from error
            raise


class ClientKilled(Base):
    """Leaves a lock behind when it is killed."""

    def connect(self) -> Any:
        with suppress(FileNotFoundError):
            if self._lock.read_text() != str(os.getpid()):
                self._lock.unlink()
                raise DeviceRefused("HC-C99", "Device", "connect", "held by another program")
        found = super().connect()
        self._lock.write_text(str(os.getpid()))
        return found

    def close(self) -> None:
        super().close()
        if not self.connecting:
            self._lock.unlink(missing_ok=True)

    @property
    def _lock(self) -> Path:
        place = getattr(self.options, "channel", "") or str(getattr(self.options, "port", ""))
        return Path(tempfile.gettempdir()) / f"hilcell-lock-{place.rpartition(':')[2]}"


class StopAtOnce(Base):
    def stop(self) -> None:
        time.sleep(0.1)
        super().stop()


class StopRests(Base):
    """Notes a stop, and lets the device move on."""

    def stop(self) -> None:
        self.stopped = True

    def visited(self, call: Call) -> Any:
        self._check()
        return super().visited(call)

    def moved(self, call: Call) -> Any:
        self._check()
        return super().moved(call)

    def _check(self) -> None:
        if self.stopped:
            raise DeviceError("HC-C99", "Device", "move", "it was stopped")


class StopHolds(Base):
    def stop(self) -> None:
        self.stopped = True
        super().stop()

    def visited(self, call: Call) -> Any:
        self._again()
        return super().visited(call)

    def moved(self, call: Call) -> Any:
        self._again()
        return super().moved(call)

    def _again(self) -> None:
        if self.stopped:
            self.connect()


class DeafClock:
    def __init__(self, clock: Any) -> None:
        self._clock = clock

    def now_s(self) -> float:
        return float(self._clock.now_s())

    def pc_s(self) -> float:
        return float(self._clock.pc_s())

    def wait(self, duration_s: float) -> None:
        with suppress(Stopped):
            self._clock.wait(duration_s)

    def check(self) -> None:
        pass


class Checked(Base):
    def __init__(self, options: Any, clock: Any) -> None:
        super().__init__(options, DeafClock(clock))


COMMON: dict[str, type[Base]] = {
    "identity-same": IdentitySame,
    "identity-clean": IdentityClean,
    "identity-wrong": IdentityWrong,
    "unreachable": Unreachable,
    "not-connected": NotConnected,
    "connect-twice": ConnectTwice,
    "close-twice": CloseTwice,
    "stop-twice": StopTwice,
    "taken": Taken,
    "no-number": NoNumber,
    "reads-back": ReadsBack,
    "at-rest": AtRest,
    "ended": Ended,
    "silent": Silent,
    "late": Late,
    "slow": Slow,
    "pieces": Pieces,
    "garbage": Garbage,
    "device-killed": DeviceKilled,
    "client-killed": ClientKilled,
    "stop-at-once": StopAtOnce,
    "stop-rests": StopRests,
    "stop-holds": StopHolds,
    "checked": Checked,
}
