"""Deprecated path of `vgmpi fit`."""

import sys

from vgmpi.apps.commands import run_old_module

sys.exit(run_old_module("fit", "fit", ["fit", *sys.argv[1:]]))
