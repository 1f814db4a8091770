"""Deprecated path of `vgmpi photo`."""

import sys

from vgmpi.apps.commands import run_old_module

sys.exit(run_old_module("images", "photo", ["photo", *sys.argv[1:]]))
