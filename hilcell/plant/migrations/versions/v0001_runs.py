"""Runs with their parts; points in partitions by month, which a function makes for the cells."""

import sqlalchemy as sa
from alembic import op

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
    """Make all tables."""
    moment = sa.DateTime(timezone=True)
    number: sa.Double[float] = sa.Double()
    op.create_table(
        "run",
        sa.Column("digest", sa.Uuid(), primary_key=True),
        sa.Column("run_key", sa.Uuid(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("head", sa.String(64), nullable=False),
        sa.Column("month", sa.Date(), nullable=False),
        sa.Column("cell_key", sa.Uuid(), nullable=False),
        *_words("name", "cell", "serial"),
        sa.Column("simulated", sa.Boolean(), nullable=False),
        *_words("machine", "procedure", "state"),
        sa.Column("exit", sa.Integer(), nullable=False),
        sa.Column("begun", moment, nullable=False),
        sa.Column("ended", moment, nullable=False),
        sa.Column("points", sa.Integer(), nullable=False),
        sa.Column("proven", sa.Boolean(), nullable=False),
        *_words("robot", "tracker", "version"),
        sa.Column("row", sa.JSON(), nullable=False),
        sa.Column("shipped", moment, nullable=False, server_default=sa.func.now()),
        sa.UniqueConstraint("run_key", "revision", name="run_revision"),
    )
    proven = sa.text("proven")
    op.create_index("run_of_cell", "run", ["cell_key", "ended", "revision"])
    op.create_index(
        "run_proven", "run", ["cell_key", "ended"], postgresql_where=proven, sqlite_where=proven
    )
    op.create_index("run_of_robot", "run", ["robot", "ended"])
    op.create_table(
        "frame",
        _digest(),
        sa.Column("key", sa.Text(), primary_key=True),
        sa.Column("matrix", sa.JSON(), nullable=False),
        sa.Column("covariance", sa.JSON()),
    )
    op.create_table(
        "verdict",
        _digest(),
        sa.Column("key", sa.Text(), primary_key=True),
        sa.Column("holds", sa.Boolean(), nullable=False),
        *(sa.Column(name, number) for name in ("mean_mm", "mean_U_mm", "mean_tolerance_mm")),
        sa.Column("body", sa.JSON(), nullable=False),
    )
    op.create_table(
        "device",
        *_part(),
        *_words("kind", "device", "maker", "model", "serial", "firmware"),
        sa.Column("simulated", sa.Boolean(), nullable=False),
    )
    op.create_index("device_serial", "device", ["kind", "serial"])
    op.create_table(
        "alarm",
        *_part(),
        sa.Column("t", moment, nullable=False),
        *_words("code", "severity", "title", "place", "found"),
    )
    op.create_index("alarm_code", "alarm", ["code", "t"])
    op.create_table(
        "length",
        *_part(),
        *_words("nests"),
        *(sa.Column(name, number, nullable=False) for name in ("wanted_mm", "found_mm", "U_mm")),
    )
    op.create_table(
        "grid",
        _digest(),
        sa.Column("places_mm", sa.JSON(), nullable=False),
        sa.Column("errors_mm", sa.JSON(), nullable=False),
        sa.Column("temperature_c", number),
    )
    measured = ("x_mm", "y_mm", "z_mm", "std_x_mm", "std_y_mm", "std_z_mm")
    unsure = (
        "temperature_c", "pressure_mbar", "humidity_percent", "strip_mm", "rail_mm",
        "nominal_x_mm", "nominal_y_mm", "nominal_z_mm",
    )  # fmt: skip
    op.create_table(
        "point",
        sa.Column("month", sa.Date(), primary_key=True),
        sa.Column("digest", sa.Uuid(), primary_key=True),
        sa.Column("seq", sa.Integer(), primary_key=True),
        sa.Column("t", moment, nullable=False),
        *_words("key", "kind", "station", "frame", "reflector"),
        *(sa.Column(name, number, nullable=False) for name in measured),
        *(sa.Column(n, sa.Integer(), nullable=False) for n in ("samples", "session", "set_up")),
        sa.Column("retaken", sa.Boolean(), nullable=False),
        *(sa.Column(name, number) for name in unsure),
        sa.Column("commanded_deg", sa.JSON()),
        sa.Column("joints_deg", sa.JSON()),
        postgresql_partition_by="RANGE (month)",
    )
    if op.get_bind().dialect.name == "postgresql":
        op.execute("CREATE TABLE point_other PARTITION OF point DEFAULT")
        op.execute(MONTHS)
        op.execute("REVOKE EXECUTE ON FUNCTION plant_month(date) FROM PUBLIC")


def _digest() -> sa.Column[object]:
    return sa.Column("digest", sa.Uuid(), sa.ForeignKey("run.digest"), primary_key=True)


def _part() -> tuple[sa.Column[object], ...]:
    return _digest(), sa.Column("n", sa.Integer(), primary_key=True)


def _words(*names: str) -> list[sa.Column[str]]:
    return [sa.Column(name, sa.Text(), nullable=False) for name in names]
