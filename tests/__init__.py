"""Tests of hilcell; workers are as many as processors, so each computes in one thread."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is loaded
