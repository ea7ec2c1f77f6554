"""Imported by Python as it starts, where `PYTHONPATH` names this folder: see `..patch`."""

from campaigns.breaks.patch import install

install()
