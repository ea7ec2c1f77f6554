"""The form of each record: from the third on, its digest is that of its rows."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Add the column; the records that are there are of the second form at most."""
    form: sa.Column[int] = sa.Column("form", sa.Integer(), nullable=False, server_default="2")
    op.add_column("run", form)
