"""Promises of every port: identities, and calls that may be repeated."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from hilcell.clean import UNSAFE, clean
from hilcell.conformance.acts import Reading
from hilcell.conformance.bench import Bench
from hilcell.conformance.trial import Promise
from hilcell.conformance.verdicts import Broken, NotApplicable, fails, need
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
    _near(bench, bench.acts.visit(driver, 1), 1)


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
    _near(bench, bench.acts.visit(driver, 0), 0)


def _near(bench: Bench, reading: Reading, place: int) -> None:
    off, limit = bench.acts.off(reading, place), bench.acts.tolerance
    if not off <= limit:
        unit = bench.acts.unit
        raise Broken(f"reads {off:.4f} {unit} from place {place}, wanted <= {limit:g} {unit}")


near = _near

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
)  # fmt: skip
