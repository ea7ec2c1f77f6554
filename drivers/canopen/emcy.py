"""Error codes of EMCY messages (CiA 301, table 26) and of drives (CiA 402-2, annex)."""

from __future__ import annotations

HEARTBEAT_LOST = 0x8130
CODES = {
    0x1000: "generic error",
    0x2310: "continuous over-current",
    0x2320: "short circuit or earth leakage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "excess temperature of the device",
    0x4310: "excess temperature of the drive",
    0x5441: "emergency stop input",
    0x6320: "parameter error",
    0x7121: "motor blocked",
    0x7305: "incremental sensor 1 fault",
    0x7320: "position sensor",
    0x8110: "CAN overrun: frames lost",
    0x8120: "CAN in error passive mode",
    HEARTBEAT_LOST: "heartbeat or life guard error",
    0x8140: "recovered from bus off",
    0x8150: "collision of COB identifiers",
    0x8210: "PDO not processed: wrong length",
    0x8220: "PDO too long",
    0x8500: "position controller",
    0x8611: "following error",
    0x8612: "reference limit",
}
FAMILIES = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current at the input",
    0x22: "current inside",
    0x23: "current at the output",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x43: "drive temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x70: "additional modules",
    0x71: "motor",
    0x73: "sensor",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x86: "positioning",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "device specific",
}


# Which alarm a code raises: by the code, by its family (its first byte), by the first half of it.
ALARMS = {0x5441: "HC-R20", 0x7121: "HC-R21", 0x8612: "HC-R32"}
ALARMS_OF_FAMILIES = {
    0x20: "HC-R21",
    0x30: "HC-R22",
    0x40: "HC-R23",
    0x73: "HC-R24",
    0x81: "HC-R25",
    0x82: "HC-R25",
    0x85: "HC-R26",
    0x86: "HC-R26",
}
ANY = "HC-R27"


def alarm(code: int) -> str:
    """Return the code of the alarm that an error code raises."""
    family = code >> 8
    of_family = ALARMS_OF_FAMILIES.get(family) or ALARMS_OF_FAMILIES.get(family & 0xF0)
    return ALARMS.get(code) or of_family or ANY


def is_error(code: int) -> bool:
    """Whether a code reports an error; 00xxh says that errors are gone."""
    return code & 0xFF00 != 0


def text(code: int) -> str:
    """Return a code with the standard's meaning."""
    meaning = CODES.get(code) or FAMILIES.get(code >> 8) or FAMILIES.get(code >> 8 & 0xF0)
    return f"0x{code:04X} ({meaning or 'unknown'})"
