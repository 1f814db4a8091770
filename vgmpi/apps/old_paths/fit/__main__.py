"""Deprecated path of `vgmpi fit`."""

import sys

from vgmpi.apps.fit.__main__ import main

print("python -m vgmpi.fit is now: vgmpi fit", file=sys.stderr)
sys.exit(main())
