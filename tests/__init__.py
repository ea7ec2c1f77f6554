"""Tests of everything, on one thread of linear algebra as the command has it."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy is imported
for name in ("LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG"):  # English, whoever runs them
    os.environ.pop(name, None)
