"""The life of a child: ``python -m vhp_cli.processes PARENT MEMORY_GB``."""

from __future__ import annotations

import sys

from vhp_cli.processes.serving import serve

if __name__ == "__main__":
    serve(int(sys.argv[1]), float(sys.argv[2]))
