"""Deprecated path of `vgmpi convert`."""

import sys

from vgmpi.apps.commands import run_old_module

sys.exit(run_old_module("convert", "convert", ["convert", *sys.argv[1:]]))
