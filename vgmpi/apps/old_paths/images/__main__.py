"""Deprecated path of `vgmpi photo`."""

import sys

from vgmpi.apps.photo.__main__ import main

print("python -m vgmpi.images is now: vgmpi photo", file=sys.stderr)
sys.exit(main())
