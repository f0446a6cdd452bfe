"""``python -m vhp_cli.child PARENT ARGUMENTS`` is ``vhp ARGUMENTS``, ended by the end of the process PARENT."""

from __future__ import annotations

import sys

from vhp_cli.cli import main
from vhp_cli.processes.serving import die_with

if __name__ == "__main__":
    die_with(int(sys.argv[1]))
    sys.exit(main(sys.argv[2:]))
