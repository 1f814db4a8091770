"""Command python -m vgmpi.scene > docs/reference/scene.md: unit, default, meaning of every key."""

import sys

from .markdown_reference import scene_reference

sys.stdout.write(scene_reference())
