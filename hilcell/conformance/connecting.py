"""Promises of every port: identities, calls that may be repeated, and readings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import msgspec

from hilcell.clean import UNSAFE, clean
from hilcell.conformance.acts import Reading
from hilcell.conformance.trial import Bench, Broken, NotApplicable, Promise, fails, need
from hilcell.errors import DeviceError
from hilcell.ports import Identity


def same_identity(bench: Bench) -> None:
    """Connect twice, and compare."""
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


def clean_identity(bench: Bench) -> None:
    """Spoil the model's name on the wire where it can be found there."""
    bench.present()
    driver = bench.build()
    texts = [text for each in _assets(driver.connect()) for text in each]
    driver.close()
    least_word = 4
    words = [word for text in texts for word in text.split() if len(word) >= least_word]
    for word in words:
        for encoding in ("ascii", "utf-16-le"):
            spoiled = f"{word[:-1]}\x1b"
            if word.isascii():
                bench.wires.rewrite(word.encode(encoding), spoiled.encode(encoding))
    try:
        texts += [text for each in _assets(bench.build().connect()) for text in each]
    except DeviceError as error:
        texts.append(error.summary)
    unsafe = [text for text in texts if UNSAFE.search(text)]
    need(not unsafe, f"control characters of the device in {unsafe}; wanted {clean('')!r}")


def wrong_serial(bench: Bench) -> None:
    """Expect another serial number, one option at a time."""
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
    other_number, other_text = 16_777_213, "no such serial"
    for key in options.__struct_fields__:
        value = getattr(options, key)
        if isinstance(value, msgspec.Struct):
            for what, changed in _other_serials(value):
                yield f"{key}.{what}", {key: msgspec.structs.replace(value, **changed)}
        elif key.endswith("serial"):
            other = other_text if isinstance(value, str) else other_number
            yield f"{key} {other!r}", {key: other}


def unreachable(bench: Bench) -> None:
    """Connect to a device that nobody answers for, then to one that is back."""
    bench.connected().close()
    bench.wires.refuse()
    driver = bench.build()
    try:
        fails("connect to nobody", driver.connect)
        driver.close()
    finally:
        bench.wires.admit()
    driver.connect()


def not_connected(bench: Bench) -> None:
    """Use a driver that was never connected."""
    bench.present()
    driver = bench.build()
    fails("before connect", lambda: bench.acts.ask(driver))


def connect_twice(bench: Bench) -> None:
    """Connect a driver that is connected."""
    driver = bench.connected()
    driver.connect()
    bench.acts.ready(driver)
    near(bench, bench.acts.visit(driver, 1), 1)


def close_twice(bench: Bench) -> None:
    """Close before connect, twice after it, and connect again."""
    driver = bench.build()
    driver.close()
    driver.connect()
    driver.close()
    driver.close()
    driver.connect()
    bench.acts.ask(driver)


def stop_twice(bench: Bench) -> None:
    """Stop before connect, twice after it, and after close."""
    driver = bench.build()
    driver.stop()
    driver.connect()
    driver.stop()
    driver.stop()
    driver.close()
    driver.stop()
    driver.connect()
    bench.acts.ready(driver)
    near(bench, bench.acts.visit(driver, 0), 0)


def near(bench: Bench, reading: Reading, place: int) -> None:
    """Raise `Broken` where a reading is not of a place."""
    off, limit = bench.acts.off(reading, place), bench.acts.tolerance
    if not off <= limit:
        unit = bench.acts.unit
        raise Broken(f"reads {off:.4f} {unit} from place {place}, wanted <= {limit:g} {unit}")


def taken(bench: Bench) -> None:
    """Compare a reading's time with those of the question and the answer."""
    driver = bench.connected()
    for ask in (bench.acts.ask, lambda device: bench.acts.visit(device, 1), bench.acts.ask):
        asked_s = bench.clock.pc_s()
        taken_s = ask(driver).taken_s
        early_ms, late_ms = 1000 * (asked_s - taken_s), 1000 * (taken_s - bench.clock.pc_s())
        need(early_ms <= 0, f"taken {early_ms:.1f} ms before the question")
        need(late_ms <= 0, f"taken {late_ms:.1f} ms after the answer")


def no_number(bench: Bench) -> None:
    """Ask for places that are no numbers."""
    driver = bench.connected()
    for value in (math.nan, math.inf, -math.inf):
        fails(f"a place that is {value}", partial(bench.acts.refused, driver, value))


def reads_back(bench: Bench) -> None:
    """Visit places, and read there."""
    driver = bench.connected()
    for place in (0, 1, 0, 1, 0):
        near(bench, bench.acts.visit(driver, place), place)


def at_rest(bench: Bench) -> None:
    """Read a device that stands, while its axes dither."""
    driver = bench.connected()
    first = bench.acts.visit(driver, 1)
    reads = 5
    for n in range(1, reads + 1):
        reading = bench.acts.ask(driver)
        need(reading.still, f"reading {n} of {reads} at rest says that it moves")
        apart = bench.acts.apart(first, reading)
        need(apart <= 1.0, f"reading {n} of {reads} at rest: {apart:.1f} of what a rest allows")


def ended(bench: Bench) -> None:
    """Compare the end of a motion with the readings before and after it."""
    bench.present()
    driver = bench.connected()
    began_s = bench.clock.pc_s()
    reading = bench.acts.visit(driver, 1)
    need(reading.ended_s is not None, "no end of the motion is stated")
    need(began_s <= reading.ended_s, "the motion ended before it was asked for")
    later = bench.acts.ask(driver)
    need(later.ended_s == reading.ended_s, "the end of the motion changes at rest")
    need(later.ended_s <= later.taken_s, "the reading was taken before the motion ended")


PROMISES = (
    Promise("identity-same", "Two connects give the same identity, with model and serial number.",
            same_identity),
    Promise("identity-clean", "No control character of the device is in an identity or an error.",
            clean_identity),
    Promise("identity-wrong", "A device with another serial number than the options' is refused.",
            wrong_serial),
    Promise("unreachable", "Connect to nobody raises a DeviceError; a later connect works.",
            unreachable),
    Promise("not-connected", "A driver that is not connected raises a DeviceError.", not_connected),
    Promise("connect-twice", "A connected driver may be connected again.", connect_twice),
    Promise("close-twice", "Close works at any time, and a closed driver connects.", close_twice),
    Promise("stop-twice", "Stop works at any time; connect takes it back.", stop_twice),
    Promise("taken", "A reading's time lies between the question and the answer.", taken,
            real=True),
    Promise("no-number", "A place that is NaN or infinite is refused with a DeviceError.",
            no_number),
    Promise("reads-back", "After each motion or measurement the reading is of the place asked for.",
            reads_back, real=True),
    Promise("at-rest", "A device that stands and dithers reads as still.", at_rest,
            ("rail", "robot"), real=True),
    Promise("ended", "Readings state when the last motion ended, and were taken after it.", ended,
            ("rail", "robot"), real=True),
)  # fmt: skip
