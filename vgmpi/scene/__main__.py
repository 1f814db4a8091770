"""Command python -m vgmpi.scene > docs/reference/scene.md: every key with unit, default and meaning."""

import sys

from .markdown_reference import scene_reference

sys.stdout.write(scene_reference())
