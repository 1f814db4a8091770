"""The script that makes the gallery reads what a run of today writes."""

import importlib.util
from pathlib import Path

import pytest

from tests.support.small_scenes import BALL, ROOM, write
from vgmpi.commands import cli

SCRIPT = Path(__file__).resolve().parents[2] / "runs" / "gallery.py"


@pytest.fixture
def gallery():
    spec = importlib.util.spec_from_file_location("gallery_script", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_run_is_recorded(gallery, tmp_path):
    path, out = write(tmp_path, ROOM.replace("end = 1", "end = 1e-3") + BALL), tmp_path / "out"
    assert cli.main([str(path), "-o", str(out), "-q"]) == 0
    known = gallery.known_of(out, 1.5, 2.5, 3)
    assert known["particles"] > 10 and known["mass_lost"] < 1e-12
    assert (known["simulated"], known["drawn"], known["pictures"]) == (1.5, 2.5, 3)
