"""hilcell calibrates a robot on a cheap rail with a laser tracker, unattended."""

__version__ = "0.1.0"
