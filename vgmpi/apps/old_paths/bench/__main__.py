"""Deprecated path of `vgmpi bench`."""

import sys

from vgmpi.apps.commands import run_old_module

sys.exit(run_old_module("bench", "bench", ["bench", *sys.argv[1:]]))
