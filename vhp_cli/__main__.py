"""``python -m vhp_cli`` is ``vhp``."""

from __future__ import annotations

import sys

from vhp_cli.cli import main

if __name__ == "__main__":
    sys.exit(main())
