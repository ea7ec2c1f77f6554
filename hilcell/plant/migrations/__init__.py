"""Alembic migrations of the plant's database."""
