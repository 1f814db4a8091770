"""Deprecated path of `vgmpi bench`."""

import sys

from vgmpi.apps.bench.__main__ import main

print("python -m vgmpi.bench is now: vgmpi bench", file=sys.stderr)
sys.exit(main())
