"""SDO to one node (CiA 301, 7.2.4): typed by its EDS, one at a time, stop-aware.

After a timeout canopen hands the late reply to the next request of the same object. So a channel
that missed a reply is tainted: it waits, drops late replies, asks something else, and accepts a
value only when it reads twice the same. A node that answers each of several questions twice is two
nodes with one number.
"""

from __future__ import annotations

import queue
import struct
import threading
import time
from collections.abc import Callable
from functools import cache
from importlib import resources

from canopen import RemoteNode, import_od
from canopen.objectdictionary import SIGNED_TYPES, ObjectDictionary, ODVariable
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.canopen.can_link import CanLink
from drivers.device_errors import RAIL
from hilcell.ports import DeviceError

POLL_S = 0.02
REPLY_S = 0.3

# No such object, no such sub-index, no data available.
ABSENT = frozenset({0x06020000, 0x06090011, 0x08000024})
READ_ONLY = frozenset({0x06010000, 0x06010002})  # unsupported access, a write to a read-only object


class Aborted(DeviceError):
    """The node refused; ``abort_code`` is that of CiA 301, table 22."""

    def __init__(self, operation: str, error: SdoAbortedError) -> None:
        self.abort_code = error.code
        super().__init__(
            "HC-R09",
            RAIL.name,
            operation,
            f"SDO abort {str(error).removeprefix('Code ')}",
            act="the device differs from its EDS, or is in the wrong state; see docs/hardware.md",
            fields={"abort_code": error.code},
        )


class Unsupported(DeviceError):
    """The device lacks what its job needs, or refuses it."""

    def __init__(self, refusal: Aborted, what: str) -> None:
        """``what`` is the object, with its value and what it is for."""
        super().__init__(
            "HC-R09",
            RAIL.name,
            refusal.operation,
            f"not supported: {what}; {refusal.found}",
            expected="what docs/hardware.md says that a device must have",
            act="set the device up for it, or take one that has it",
            fields={**refusal.fields, "what": what},
        )


class _Client(SdoClient):
    """canopen's client, waiting in slices of `POLL_S`."""

    def __init__(
        self,
        request: int,
        response: int,
        objects: ObjectDictionary,
        link: CanLink,
        check: Callable[[], None],
    ) -> None:
        super().__init__(request, response, objects)  # type: ignore[no-untyped-call] # canopen's
        self.link, self.check = link, check

    def read_response(self) -> bytes:
        deadline_s = self.link.time.listened_s + REPLY_S
        while True:
            self.check()
            self.link.check()
            over = self.link.time.listened_s > deadline_s  # replies until then count
            try:
                response: bytes = self.responses.get(timeout=POLL_S)
            except queue.Empty:
                if over:
                    raise SdoCommunicationError(f"no answer within {REPLY_S:.1f} s") from None
                continue
            if len(response) != 8:
                raise SdoCommunicationError(f"an answer of {len(response)} bytes")
            if response[0] == 0x80:
                raise SdoAbortedError(struct.unpack_from("<L", response, 4)[0])
            return response

    def abort(self, abort_code: int = 0x08000000) -> None:
        """Abort the transfer; canopen's own also prints on the screen."""
        self.send_request(struct.pack("<BHBL", 0x80, 0, 0, abort_code))  # type: ignore[no-untyped-call] # canopen's


class SdoChannel:
    """Objects of one node; used by one thread at a time."""

    TRIES = 3
    LATE_S = 0.5  # a late reply has come by then
    DOUBLES = 3  # questions in a row that were answered twice; a frame may be doubled in transit

    def __init__(
        self, number: int, node: RemoteNode, link: CanLink, check: Callable[[], None]
    ) -> None:
        self._number = number
        self._link, self._check = link, check
        self._objects = node.object_dictionary
        self._aliases: dict[tuple[int, int], ODVariable] = {}
        self._lock = threading.Lock()
        self._tainted = False
        self._doubles = 0
        node.sdo_channels.clear()
        self._client = _Client(0x600 + number, 0x580 + number, self._objects, link, check)
        node.sdo_channels.append(self._client)
        node.sdo = self._client

    def alias(self, index: int, sub: int, like_index: int, like_sub: int) -> None:
        """Let an object that the EDS lacks have the type of one that it has."""
        self._aliases[index, sub] = self._object(like_index, like_sub)

    def read(self, index: int, sub: int = 0, *, tries: int = TRIES) -> int:
        """Value as the EDS types it; raises `Aborted` or `DeviceError`. A shorter integer is the
        same number; one that does not fit the type is no answer.
        """
        variable = self._object(index, sub)

        def upload() -> bytes:
            data = self._upload(index, sub, unsized=len(variable) // 8)
            _number(data, variable)
            return data

        return _number(self._retried(f"read {_name(index, sub)}", upload, tries), variable)

    def read_if_present(self, index: int, sub: int = 0, *, tries: int = TRIES) -> int | None:
        """Return the value of an object that a device may leave out; None where it does."""
        try:
            return self.read(index, sub, tries=tries)
        except Aborted as error:
            if error.abort_code not in ABSENT:
                raise
            return None

    def read_bytes(self, index: int, sub: int = 0) -> bytes:
        """Return the value's bytes; retried, because reading changes nothing."""
        operation = f"read {_name(index, sub)}"
        return self._retried(operation, lambda: self._upload(index, sub))

    def write(self, index: int, sub: int, value: int) -> None:
        """Write a setting and read it back; raises `Aborted` or `DeviceError`."""
        operation = self.command(index, sub, value)
        found = self.read(index, sub)
        if found != value:
            raise RAIL.failed(
                "HC-R09",
                operation,
                f"reads back as {found}",
                expected=str(value),
                node=self._number,
                object=_name(index, sub),
                read=found,
                written=value,
            )

    def offer(self, index: int, sub: int, value: int) -> Aborted | None:
        """Write a setting; return the refusal of a device that does not have that value already."""
        try:
            self.write(index, sub, value)
        except Aborted as refusal:
            try:
                held = self.read(index, sub)
            except Aborted:
                return refusal
            return None if held == value else refusal
        return None

    def require(
        self, index: int, sub: int, value: int, what: str, *, optional: bool = False
    ) -> None:
        """Write a setting that the device must accept; ``what`` is its purpose.

        An ``optional`` one may be missing. Raises `Unsupported` where it refuses, `DeviceError`
        where it does not store it.
        """
        refusal = self.offer(index, sub, value)
        if refusal is not None and not (optional and refusal.abort_code in ABSENT):
            raise Unsupported(refusal, f"{_name(index, sub)} = {value} ({what})")

    def is_read_only(self, index: int, sub: int) -> bool:
        """Whether the device refuses to be written the value that it has; raises `DeviceError`."""
        try:
            self.command(index, sub, self.read(index, sub))
        except Aborted as refusal:
            return refusal.abort_code in READ_ONLY
        return False

    def command(self, index: int, sub: int, value: int) -> str:
        """Write what the device obeys at once; its state shows whether it did. Return the
        operation's text; raises `Aborted` or `DeviceError`.
        """
        operation = f"write {_name(index, sub)}"
        data = self._object(index, sub).encode_raw(value)
        self._retried(operation, lambda: self._download(index, sub, data))
        return operation

    def post(self, index: int, sub: int, value: int) -> None:
        """Write what the device obeys at once, and wait for no answer; raises `LinkLost`."""
        data = self._object(index, sub).encode_raw(value)
        head = struct.pack(
            "<BHB", 0x23 | 4 - len(data) << 2, index, sub
        )  # expedited, with its size
        with self._lock:
            self._tainted = True
            self._link.send(0x600 + self._number, head + data.ljust(4, b"\0"))

    def _retried(self, operation: str, transfer: Callable[[], bytes], tries: int = TRIES) -> bytes:
        with self._lock:
            for _ in range(tries):
                try:
                    return self._once(transfer)
                except SdoAbortedError as error:
                    self._tainted = False  # a refusal is an answer
                    raise Aborted(operation, error) from error
                except SdoCommunicationError as error:
                    reason = str(error)
        raise RAIL.failed(
            "HC-R06",
            operation,
            f"node {self._number}: {reason}, {tries} times",
            node=self._number,
            tries=tries,
            reason=reason,
        )

    def _once(self, transfer: Callable[[], bytes]) -> bytes:
        if not self._tainted:
            self._check_alone()
            self._tainted = True
            data = transfer()
        else:
            self._clear()
            data = transfer()
            if transfer() != data:
                raise SdoCommunicationError("two reads in a row differ")
        self._tainted = False
        return data

    def _check_alone(self) -> None:
        """Raise `DeviceError` where more answers have come than questions were asked."""
        self._doubles = 0 if self._client.responses.empty() else self._doubles + 1
        if self._doubles >= self.DOUBLES:
            raise RAIL.failed(
                "HC-R45",
                "ask",
                f"node {self._number} has answered {self._doubles} questions in a row twice",
                expected="one answer",
                node=self._number,
                doubles=self._doubles,
            )

    def _clear(self) -> None:
        """Let a late reply come and pass, then ask something that it cannot answer."""
        deadline_s = self._link.time.listened_s + self.LATE_S
        while self._link.time.listened_s < deadline_s:
            self._check()
            self._link.check()
            time.sleep(POLL_S)
        self._upload(0x1018, 0)

    def _upload(self, index: int, sub: int, *, unsized: int = 4) -> bytes:
        """Return an object's bytes; ``unsized`` of them count where the answer states no size."""
        with self._client.open(index, sub, buffering=0) as stream:  # type: ignore[no-untyped-call] # canopen's
            data = bytes(stream.read())
            return data if stream.size is not None else data[:unsized]

    def _download(self, index: int, sub: int, data: bytes) -> bytes:
        self._client.download(index, sub, data)
        return data

    def _object(self, index: int, sub: int) -> ODVariable:
        variable = self._aliases.get((index, sub)) or self._objects.get_variable(index, sub)
        if variable is None:
            raise LookupError(f"{_name(index, sub)} is missing in the EDS of node {self._number}")
        return variable


def _number(data: bytes, variable: ODVariable) -> int:
    """Return an integer of CiA 301, 7.1.4; raises `SdoCommunicationError` where it is none."""
    signed = variable.data_type in SIGNED_TYPES
    value = int.from_bytes(data, "little", signed=signed)
    bits = len(variable)
    lowest = -(1 << bits - 1) if signed else 0
    if not data or not lowest <= value < lowest + (1 << bits):
        raise SdoCommunicationError(
            f"an answer of {len(data)} bytes ({data.hex(' ') or 'none'}), "
            f"expected a number of {bits // 8} bytes"
        )
    return value


def _name(index: int, sub: int) -> str:
    return f"{index:04X}h:{sub:02X}"


def open_channel(link: CanLink, node: int, eds: str, check: Callable[[], None]) -> SdoChannel:
    remote = RemoteNode(node, _objects(eds, node))
    channel = SdoChannel(node, remote, link, check)
    link.network.add_node(remote)
    return channel


@cache
def _objects(eds: str, node: int) -> ObjectDictionary:
    """Content of a file, cached so that the end of a session reads none."""
    with resources.as_file(resources.files("drivers.canopen") / "eds" / eds) as path:
        return import_od(str(path), node)
