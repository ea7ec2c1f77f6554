"""Documents and streams of a run; points that do not count are kept, too, and say so."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Make the two tables; the points that are there all count."""
    op.create_table(
        "stream",
        _digest(),
        sa.Column("key", sa.Text(), primary_key=True),
        sa.Column("file", sa.Text(), nullable=False),
        _sha256(),
        sa.Column("samples", sa.Integer(), nullable=False),
        sa.Column("joint_samples", sa.Integer(), nullable=False),
    )
    op.create_table(
        "document",
        _digest(),
        sa.Column("name", sa.Text(), primary_key=True),
        _sha256(),
        sa.Column("text", sa.Text(), nullable=False),
    )
    superseded: sa.Column[bool] = sa.Column(
        "superseded", sa.Boolean(), nullable=False, server_default=sa.false()
    )
    op.add_column("point", superseded)


def _digest() -> sa.Column[object]:
    return sa.Column("digest", sa.Uuid(), sa.ForeignKey("run.digest"), primary_key=True)


def _sha256() -> sa.Column[str]:
    return sa.Column("sha256", sa.String(64), nullable=False)
