"""All tables; the view of the newest revisions, and the trigger that keeps which these are.

The next migration first writes out here what `hilcell.plant.tables` has until then.
"""

from alembic import op

from hilcell.plant.tables import TABLES

revision = "0001"
down_revision = None

KEPT = """
    UPDATE run SET newest = NOT newest WHERE run_key = NEW.run_key AND newest <> (
        revision = (SELECT max(revision) FROM run AS every WHERE every.run_key = NEW.run_key));
"""
# The lock: of two revisions at once, each would miss the other.
ON_POSTGRESQL = f"""
CREATE FUNCTION plant_newest() RETURNS trigger
LANGUAGE plpgsql SECURITY DEFINER SET search_path FROM CURRENT AS $$
BEGIN
    PERFORM pg_advisory_xact_lock(hashtextextended(NEW.run_key::text, 0));
    {KEPT}
    RETURN NULL;
END $$;
REVOKE EXECUTE ON FUNCTION plant_newest() FROM PUBLIC;
CREATE TRIGGER run_newest AFTER INSERT ON run FOR EACH ROW EXECUTE FUNCTION plant_newest();
"""
ON_SQLITE = f"CREATE TRIGGER run_newest AFTER INSERT ON run BEGIN {KEPT} END"


def upgrade() -> None:
    TABLES.create_all(op.get_bind(), checkfirst=False)
    op.execute("CREATE VIEW current_run AS SELECT * FROM run WHERE newest")
    op.execute(ON_POSTGRESQL if op.get_bind().dialect.name == "postgresql" else ON_SQLITE)
