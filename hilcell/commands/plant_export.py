"""``plant export`` and ``plant verify``: one cell's record for an auditor, signed by the plant."""

from __future__ import annotations

import getpass
import sys
from contextlib import closing

from hilcell.clean import encodable, harmless
from hilcell.commands.orders import PlantExport, PlantVerify
from hilcell.commands.output import print_answer, print_message
from hilcell.commands.plant import open_database, require_packages
from hilcell.run.exits import EXIT_OK, EXIT_OUT_OF_TOLERANCE

SIGNING = ("cryptography",)


def export(args: PlantExport) -> int:
    """Write a cell's record with a signed manifest."""
    require_packages(SIGNING)
    from hilcell.plant.export import export as export_cell
    from hilcell.plant.signing import read_private_key

    key = read_private_key(args.key, _passphrase)
    with closing(open_database(args.plant)) as database:
        database.check()
        with database.transaction() as connection:
            found = export_cell(connection, args.cell, args.serial, args.out, key)
    simulated = f", {found.simulated_runs} of them simulated" if found.simulated_runs else ""
    print_answer(
        {"cell": found.cell, "serials": found.serials, "runs": found.runs,
         "files": len(found.files), "key": found.key, "out": harmless(str(args.out))},
        f"cell {harmless(found.cell)}: {found.runs} records of runs{simulated}, "
        f"{len(found.files)} files written to {harmless(str(args.out))}, signed by {found.key}",
        as_json=args.json,
    )  # fmt: skip
    return EXIT_OK


def verify(args: PlantVerify) -> int:
    """Verify an exported record; exit code 1 where a file differs, is missing or is extra."""
    require_packages(SIGNING)
    from hilcell.plant.audit import verify as verify_record
    from hilcell.plant.signing import read_public_key

    manifest, findings = verify_record(args.record, read_public_key(args.public_key))
    for each in findings:
        print_message(f"{harmless(each.file)}: {harmless(each.what)}")
    count = len(manifest.files)
    are = "1 file is not as it was" if len(findings) == 1 else (
        f"{len(findings)} files are not as they were"
    )  # fmt: skip
    words = f"{are} signed" if findings else (
        f"all {count} files are as they were signed"
    )  # fmt: skip
    print_answer(
        {"cell": manifest.cell, "serials": manifest.serials, "runs": manifest.runs,
         "files": count, "made": manifest.made, "key": manifest.key, "holds": not findings,
         "findings": {encodable(each.file): encodable(each.what) for each in findings}},
        f"cell {harmless(manifest.cell)}: {words}, on {harmless(manifest.made)} by {manifest.key}",
        as_json=args.json,
    )  # fmt: skip
    return EXIT_OUT_OF_TOLERANCE if findings else EXIT_OK


def _passphrase() -> bytes | None:
    """Ask for the passphrase of an encrypted key, where somebody is there to be asked."""
    if not (sys.stdin is not None and sys.stdin.isatty()):
        return None
    try:
        return getpass.getpass("passphrase of the key: ").encode()
    except (EOFError, UnicodeError):  # nothing that could be one
        return b""
