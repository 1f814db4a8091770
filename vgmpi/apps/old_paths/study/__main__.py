"""Deprecated path of `vgmpi tradeoff`."""

import sys

from vgmpi.apps.tradeoff.__main__ import main

print("python -m vgmpi.study is now: vgmpi tradeoff", file=sys.stderr)
sys.exit(main())
