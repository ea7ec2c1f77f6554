"""Long campaigns that ``make test`` has no time for: ``python -m tests.torture NAME...``."""
