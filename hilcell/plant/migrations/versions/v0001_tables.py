"""All tables; the view of the newest revisions, and the triggers that keep which these are.

The next migration first writes out here what `hilcell.plant.tables` has until then.
"""

from alembic import op

from hilcell.plant.tables import KEPT, TABLES

revision = "0001"
down_revision = None

# It works as the owner, so nothing is looked up in the schema of the cell's own temporary tables
# first. The lock: of two revisions at once, each would miss the other. One a cell, for the server's
# table of locks is small.
FUNCTION = f"""
DO $$ BEGIN EXECUTE format('
CREATE FUNCTION plant_newest() RETURNS trigger
LANGUAGE plpgsql SECURITY DEFINER SET search_path = pg_catalog, %I, pg_temp AS $function$
BEGIN
    PERFORM pg_advisory_xact_lock(hashtextextended(NEW.cell_key::text, 0::bigint));
    {KEPT}
    RETURN NULL;
END $function$', current_schema()); END $$
"""
# Errors are read of all grids at once, their places are not: only these are kept elsewhere.
STORED = "ALTER TABLE grid ALTER places_mm SET STORAGE EXTERNAL, ALTER errors_mm SET STORAGE MAIN"
ON_POSTGRESQL = (
    FUNCTION,
    "REVOKE EXECUTE ON FUNCTION plant_newest() FROM PUBLIC",
    (
        "CREATE TRIGGER run_newest AFTER INSERT OR UPDATE OF accepted ON run "
        "FOR EACH ROW EXECUTE FUNCTION plant_newest()"
    ),
    STORED,
)
ON_SQLITE = tuple(
    f"CREATE TRIGGER run_newest_{n} AFTER {event} ON run BEGIN {KEPT} END"
    for n, event in enumerate(("INSERT", "UPDATE OF accepted"))
)


def upgrade() -> None:
    TABLES.create_all(op.get_bind(), checkfirst=False)
    op.execute("CREATE VIEW current_run AS SELECT * FROM run WHERE newest")
    remote = op.get_bind().dialect.name == "postgresql"
    for order in ON_POSTGRESQL if remote else ON_SQLITE:
        op.execute(order)


def downgrade() -> None:
    raise NotImplementedError("the first schema has none before it: restore a backup")
