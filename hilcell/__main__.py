"""``python -m hilcell`` is the command ``hilcell``."""

import sys

from hilcell.cli import main

sys.exit(main())
