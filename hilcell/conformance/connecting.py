"""Promises of every port: identities, calls that may be repeated, and readings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import msgspec

from hilcell.clean import UNSAFE
from hilcell.conformance.trial import Bench, NotApplicable, Promises, fails, need
from hilcell.errors import DeviceError
from hilcell.ports import Identity

PROMISES = Promises()


@PROMISES.add("identity-same")
def same_identity(bench: Bench) -> None:
    """Two connects give the same identity, with model and serial number."""
    bench.present()
    found = []
    for _ in range(2):
        driver = bench.build()
        found.append(_assets(driver.connect()))
        driver.close()
    need(found[0] == found[1], f"first {found[0]}, then {found[1]}")
    blank = [each for each in found[0] if not (each[1] and each[2])]
    need(bool(found[0]) and not blank, f"no model or no serial number: {blank or 'nobody'}")


def _assets(identities: list[Identity]) -> list[tuple[str, ...]]:
    return [
        (each.device, each.model, each.serial, each.kind, each.maker, each.firmware)
        for each in identities
    ]


@PROMISES.add("identity-clean")
def clean_identity(bench: Bench) -> None:
    """No control character of the device is in an identity or an error."""
    bench.present()
    driver = bench.build()
    texts = [text for each in _assets(driver.connect()) for text in each]
    driver.close()
    words = [word for text in texts for word in text.split() if len(word) >= 4 and word.isascii()]
    for word in words:
        for encoding in ("ascii", "utf-16-le"):
            bench.wires.rewrite(word.encode(encoding), f"{word[:-1]}\x1b".encode(encoding))
    try:
        texts += [text for each in _assets(bench.build().connect()) for text in each]
    except DeviceError as error:
        texts.append(error.summary)
    unsafe = [text for text in texts if UNSAFE.search(text)]
    need(not unsafe, f"control characters of the device in {unsafe}")


@PROMISES.add("identity-wrong")
def wrong_serial(bench: Bench) -> None:
    """A device with another serial number than the options' is refused."""
    _, options = bench.settings()
    others = list(_other_serials(options))
    if not others:
        raise NotApplicable("its options name no serial number")
    for what, changed in others:
        try:
            driver = bench.build(**changed)
        except ValueError:
            continue  # the options themselves refuse it, as one that means nothing here
        fails(f"connect with {what}", driver.connect)


def _other_serials(options: msgspec.Struct) -> Iterator[tuple[str, dict[str, object]]]:
    """Yield changes of one serial number each, in words and as options; of parts as well."""
    for key in options.__struct_fields__:
        value = getattr(options, key)
        if isinstance(value, msgspec.Struct):
            for what, changed in _other_serials(value):
                yield f"{key}.{what}", {key: msgspec.structs.replace(value, **changed)}
        elif key.endswith("serial"):
            other = "no such serial" if isinstance(value, str) else 16_777_213
            yield f"{key} {other!r}", {key: other}


@PROMISES.add("unreachable")
def unreachable(bench: Bench) -> None:
    """Connect to nobody raises a DeviceError; a later connect works."""
    bench.connected().close()
    bench.wires.refuse()
    driver = bench.build()
    try:
        fails("connect to nobody", driver.connect)
        driver.close()
    finally:
        bench.wires.admit()
    driver.connect()


@PROMISES.add("not-connected")
def not_connected(bench: Bench) -> None:
    """A driver that is not connected raises a DeviceError."""
    bench.present()
    driver = bench.build()
    fails("before connect", lambda: bench.acts.ask(driver))


@PROMISES.add("connect-twice")
def connect_twice(bench: Bench) -> None:
    """A connected driver may be connected again."""
    driver = bench.connected()
    driver.connect()
    bench.acts.ready(driver)
    bench.visit(driver, 1)


@PROMISES.add("close-twice")
def close_twice(bench: Bench) -> None:
    """Close works at any time, and a closed driver connects."""
    driver = bench.build()
    driver.close()
    driver.connect()
    driver.close()
    driver.close()
    driver.connect()
    bench.acts.ask(driver)


@PROMISES.add("stop-twice")
def stop_twice(bench: Bench) -> None:
    """Stop works at any time; connect takes it back."""
    driver = bench.build()
    driver.stop()
    driver.connect()
    driver.stop()
    driver.stop()
    driver.close()
    driver.stop()
    driver.connect()
    bench.acts.ready(driver)
    bench.visit(driver, 0)


@PROMISES.add("taken", real=True)
def taken(bench: Bench) -> None:
    """A reading's time lies between the question and the answer."""
    driver = bench.connected()
    for ask in (bench.acts.ask, lambda device: bench.acts.visit(device, 1), bench.acts.ask):
        asked_s = bench.clock.pc_s()
        taken_s = ask(driver).taken_s
        early_ms, late_ms = 1000 * (asked_s - taken_s), 1000 * (taken_s - bench.clock.pc_s())
        need(early_ms <= 0, f"taken {early_ms:.1f} ms before the question")
        need(late_ms <= 0, f"taken {late_ms:.1f} ms after the answer")


@PROMISES.add("no-number")
def no_number(bench: Bench) -> None:
    """A place that is NaN or infinite is refused with a DeviceError."""
    driver = bench.connected()
    for value in (math.nan, math.inf, -math.inf):
        fails(f"a place that is {value}", partial(bench.acts.refused, driver, value))


@PROMISES.add("reads-back", real=True)
def reads_back(bench: Bench) -> None:
    """After each motion or measurement the reading is of the place asked for."""
    driver = bench.connected()
    for place in (0, 1, 0, 1, 0):
        bench.visit(driver, place)


@PROMISES.add("at-rest", "rail", "robot", real=True)
def at_rest(bench: Bench) -> None:
    """A device that stands and dithers reads as still."""
    driver = bench.connected()
    first = bench.acts.visit(driver, 1)
    reads = 5
    for n in range(1, reads + 1):
        reading = bench.acts.ask(driver)
        need(reading.still, f"reading {n} of {reads} at rest says that it moves")
        bench.rested(first, reading, f"reading {n} of {reads} at rest")


@PROMISES.add("ended", "rail", "robot", real=True)
def ended(bench: Bench) -> None:
    """Readings state when the last motion ended, and were taken after it."""
    bench.present()
    driver = bench.connected()
    began_s = bench.clock.pc_s()
    reading = bench.acts.visit(driver, 1)
    need(reading.ended_s is not None, "no end of the motion is stated")
    need(began_s <= reading.ended_s, "the motion ended before it was asked for")
    later = bench.acts.ask(driver)
    need(later.ended_s == reading.ended_s, "the end of the motion changes at rest")
    need(later.ended_s <= later.taken_s, "the reading was taken before the motion ended")
