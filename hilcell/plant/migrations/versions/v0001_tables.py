"""All tables; on PostgreSQL a partition of points by month, which a function makes for the cells.

The next migration first writes out here what `hilcell.plant.tables` has until then.
"""

from alembic import op

from hilcell.plant.tables import TABLES

revision = "0001"
down_revision = None

MONTHS = """
CREATE FUNCTION plant_month(first date) RETURNS void
LANGUAGE plpgsql SECURITY DEFINER SET search_path FROM CURRENT AS $$
DECLARE partition text := 'point_' || to_char(first, 'YYYY_MM');
BEGIN
    IF to_regclass(partition) IS NOT NULL OR first <> date_trunc('month', first)
       OR first < date '2010-01-01' OR first > now() + interval '2 months' THEN
        RETURN;
    END IF;
    PERFORM pg_advisory_xact_lock(hashtext('hilcell.plant_month'));
    EXECUTE format(
        'CREATE TABLE IF NOT EXISTS %I PARTITION OF point FOR VALUES FROM (%L) TO (%L)',
        partition, first, (first + interval '1 month')::date
    );
EXCEPTION WHEN check_violation THEN
    RETURN;
END $$
"""


def upgrade() -> None:
    TABLES.create_all(op.get_bind(), checkfirst=False)
    if op.get_bind().dialect.name == "postgresql":
        op.execute("CREATE TABLE point_other PARTITION OF point DEFAULT")
        op.execute(MONTHS)
        op.execute("REVOKE EXECUTE ON FUNCTION plant_month(date) FROM PUBLIC")
