"""Rights on PostgreSQL: of roles, by columns and by rows.

A cell, by its name and serial number, belongs to one login (table ``claim``): the first that ships
it, or the one to which the owner assigned it. Row-level security holds each login to its cells, by
``session_user``, which no SET ROLE changes. Rows of a run's parts are taken only in the transaction
of its row. The server's own columns, time and login among them, are granted to nobody. Owner and
superusers are held to no cell.
"""

from __future__ import annotations

from collections.abc import Iterator

from sqlalchemy import Connection, text

from hilcell.plant.tables import ARCHIVE, CLAIM, DECISION, PARTS, RUN, SERVER_COLUMNS

CELL, ENGINEER = "hilcell_cell", "hilcell_engineer"  # roles
CELL_COLUMNS = ("digest", "cell_key", "run_key", "revision", "head", "shipped", "inserted_in")
_OWN_LOGIN = "login = session_user"
_OWN_CELL = (
    "(cell, serial) IN (SELECT c.cell, c.serial FROM claim AS c WHERE c.login = session_user)"
)
_OWN_RUN = (
    "EXISTS (SELECT FROM run WHERE run.digest = {part}.digest AND run.shipped >= now() "
    "AND run.inserted_in = pg_current_xact_id()::text::bigint)"
)


def admit(connection: Connection) -> None:
    """Make the two roles if needed, and give each its rights; may be repeated.

    A rule that exists is left as it is: to make one, a table is locked against its readers.
    """
    for role in (CELL, ENGINEER):
        exists = text("SELECT 1 FROM pg_roles WHERE rolname = :role")
        if connection.execute(exists, {"role": role}).scalar() is None:
            # All databases of a server share the roles: another `init` may create them now.
            create = f"""
            DO $$ BEGIN CREATE ROLE {role} NOLOGIN;
            EXCEPTION WHEN duplicate_object OR unique_violation THEN NULL;
            END $$
            """
            connection.execute(text(create))
    for order in (*_grants(), *_policies(connection)):
        connection.execute(text(order))


def _grants() -> Iterator[str]:
    inserted = ", ".join(f'"{each.name}"' for each in RUN.c if each.name not in SERVER_COLUMNS)
    parts = ", ".join(table.name for table in PARTS)
    yield f"GRANT INSERT ({inserted}), SELECT ({', '.join(CELL_COLUMNS)}) ON {RUN.name} TO {CELL}"
    yield f"GRANT INSERT (cell, serial), SELECT ON {CLAIM.name} TO {CELL}"
    yield f"GRANT INSERT ON {parts} TO {CELL}"
    yield (
        f"GRANT SELECT ON {RUN.name}, {parts}, current_run, {CLAIM.name}, {DECISION.name}, "
        f"{ARCHIVE.name} TO {ENGINEER}"
    )
    yield f"GRANT SELECT ON alembic_version TO {CELL}, {ENGINEER}"


def _policies(connection: Connection) -> Iterator[str]:
    """Yield the orders that make the missing rules."""
    rules = [(CLAIM.name, _OWN_LOGIN, _OWN_LOGIN), (RUN.name, _OWN_CELL, _OWN_CELL)]
    rules += [(part.name, "", _OWN_RUN.format(part=part.name)) for part in PARTS]
    made = text("SELECT polname FROM pg_policy WHERE polrelid = to_regclass(:table)")
    secured = text("SELECT relrowsecurity FROM pg_class WHERE oid = to_regclass(:table)")
    for table, readable, insertable in rules:
        if not connection.execute(secured, {"table": table}).scalar_one():
            yield f"ALTER TABLE {table} ENABLE ROW LEVEL SECURITY"
        policies = {
            f"{ENGINEER}_reads": f"SELECT TO {ENGINEER} USING (true)",
            f"{CELL}_inserts": f"INSERT TO {CELL} WITH CHECK ({insertable})",
        }
        if readable:
            policies[f"{CELL}_reads"] = f"SELECT TO {CELL} USING ({readable})"
        known = set(connection.execute(made, {"table": table}).scalars())
        for name in policies.keys() - known:
            yield f"CREATE POLICY {name} ON {table} FOR {policies[name]}"
