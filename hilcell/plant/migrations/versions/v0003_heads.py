"""An index by the ends of journals: a copy under another name is found by it."""

from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Make the index."""
    op.create_index("run_of_head", "run", ["head"])
