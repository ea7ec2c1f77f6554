"""``python -m hilcell`` is the command ``hilcell``."""

import sys

from hilcell.commands.cli import main

sys.exit(main())
