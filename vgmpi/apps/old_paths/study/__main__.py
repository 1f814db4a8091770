"""Deprecated path of `vgmpi tradeoff` and `vgmpi energy`, which were the words of this module."""

import sys

from vgmpi.apps.commands import run_old_module

sys.exit(run_old_module("study", "tradeoff", sys.argv[1:]))
