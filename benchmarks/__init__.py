"""Timings, as ratios within one run: machines are noisy, ratios less so."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy is imported, as `hilcell` itself does
