"""The SDO server of a simulated CANopen node (CiA 301, clause 7.2.4): expedited and segmented.

One transfer at a time; a new initiate request simply drops the transfer under way, and the toggle
bit is the only thing that tells a repeated segment from the next one.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from fakes.canopen.dictionary import Abort, ObjectDictionary, SdoAbortError

HEADER = struct.Struct("<BHB")
ABORT = 0x80
TOGGLE = 0x10


@dataclass(slots=True)
class _Transfer:
    index: int
    sub: int
    data: bytes
    announced: int | None = None
    toggle: int = 0

    def check_toggle(self, command: int) -> None:
        if command & TOGGLE != self.toggle:
            raise SdoAbortError(Abort.TOGGLE_NOT_ALTERNATED)
        self.toggle ^= TOGGLE


def abort_reply(index: int, sub: int, code: int) -> bytes:
    """Return the 8 bytes that refuse an access."""
    return HEADER.pack(ABORT, index, sub) + struct.pack("<I", code)


class SdoServer:
    """Answers the requests of one SDO channel."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._upload: _Transfer | None = None
        self._download: _Transfer | None = None

    def reset(self) -> None:
        """Forget the transfer under way."""
        self._upload = self._download = None

    def answer(self, request: bytes) -> bytes | None:
        """Return the reply to ``request``; an abort of the client gets none."""
        if len(request) != 8:
            return None
        command, index, sub = HEADER.unpack_from(request)
        if command == ABORT:
            self.reset()
            return None
        try:
            return self._dispatch(command, index, sub, request)
        except SdoAbortError as refusal:
            transfer = self._upload or self._download
            if command >> 5 in {0, 3} and transfer is not None:
                index, sub = transfer.index, transfer.sub
            self.reset()
            return abort_reply(index, sub, refusal.code)

    def _dispatch(self, command: int, index: int, sub: int, request: bytes) -> bytes:
        specifier = command >> 5
        if specifier == 2:
            return self._initiate_upload(index, sub)
        if specifier == 1:
            return self._initiate_download(command, index, sub, request)
        if specifier == 3 and self._upload is not None:
            return self._upload_segment(self._upload, command)
        if specifier == 0 and self._download is not None:
            return self._download_segment(self._download, command, request)
        raise SdoAbortError(Abort.UNKNOWN_COMMAND)

    def _initiate_upload(self, index: int, sub: int) -> bytes:
        self.reset()
        data = self._dictionary.upload(index, sub)
        if 1 <= len(data) <= 4:
            command = 0x43 | (4 - len(data)) << 2
            return HEADER.pack(command, index, sub) + data.ljust(4, b"\0")
        self._upload = _Transfer(index, sub, data)
        return HEADER.pack(0x41, index, sub) + struct.pack("<I", len(data))

    def _upload_segment(self, transfer: _Transfer, command: int) -> bytes:
        transfer.check_toggle(command)
        segment, transfer.data = transfer.data[:7], transfer.data[7:]
        reply = (command & TOGGLE) | (7 - len(segment)) << 1 | (0 if transfer.data else 1)
        if not transfer.data:
            self._upload = None
        return bytes([reply]) + segment.ljust(7, b"\0")

    def _initiate_download(self, command: int, index: int, sub: int, request: bytes) -> bytes:
        self.reset()
        expedited, sized = bool(command & 2), bool(command & 1)
        if expedited:
            length = 4 - (command >> 2 & 3) if sized else self._natural_length(index, sub)
            self._dictionary.download(index, sub, request[4 : 4 + length])
        else:
            self._dictionary.check_writable(index, sub)
            announced = struct.unpack_from("<I", request, 4)[0] if sized else None
            self._download = _Transfer(index, sub, b"", announced)
        return HEADER.pack(0x60, index, sub) + bytes(4)

    def _download_segment(self, transfer: _Transfer, command: int, request: bytes) -> bytes:
        transfer.check_toggle(command)
        transfer.data += request[1 : 8 - (command >> 1 & 7)]
        longest = 4096
        if len(transfer.data) > longest:
            raise SdoAbortError(Abort.WRONG_LENGTH)
        if command & 1:
            if transfer.announced not in {None, len(transfer.data)}:
                raise SdoAbortError(Abort.WRONG_LENGTH)
            self._dictionary.download(transfer.index, transfer.sub, transfer.data)
            self._download = None
        return bytes([0x20 | command & TOGGLE]) + bytes(7)

    def _natural_length(self, index: int, sub: int) -> int:
        entry = self._dictionary.entry(index, sub)
        return 4 if entry.kind == "s" else entry.size
