"""Deprecated path of `vgmpi convert`."""

import sys

from vgmpi.apps.convert.__main__ import main

print("python -m vgmpi.convert is now: vgmpi convert", file=sys.stderr)
sys.exit(main())
