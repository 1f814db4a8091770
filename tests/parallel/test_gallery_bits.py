"""The scenes of the gallery, coarse and short: the same bits on any number of ranks."""

import importlib.util
from pathlib import Path

import pytest

from tests.support.file_digests import digests
from tests.support.simulated_runs import run_here
from vgmpi.io.csv_log import read_rows

RUNS = Path(__file__).resolve().parents[2] / "runs"
END, LATER = 0.04, {"two_liquids": 0.4}  # [s] its pressure is implicit: it takes fewer steps
# their walls are open, and end what is within a cell of them
FINER = ("snowball", "snowman")
# too thin for coarse cells: test_scene_bits.py
ELSEWHERE = {"driftwood", "water_wheel", "honey_dipper", "rubber_sheet"}


def _gallery():
    spec = importlib.util.spec_from_file_location("gallery", RUNS / "gallery.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module", autouse=True)
def ducks(tmp_path_factory):
    """What the scene of the faucet needs, made where it is not."""
    gallery = _gallery()
    if not (RUNS / "faucet" / "assets" / "duck.ply").is_file():
        gallery.call(gallery.sys.executable, RUNS / "assets/make_assets.py", RUNS / "faucet/assets")


@pytest.mark.parametrize("name", sorted(set(_gallery().SCENES) - ELSEWHERE))
def test_the_same_bits(name, tmp_path):
    found, cell = [], 2 if name in FINER else 4
    for n in (1, 3):
        flags = ("--set", f"domain.cell={cell} cm", "--set", "time.frames=2",
                 "--set", f"time.end={LATER.get(name, END)}")  # fmt: skip
        run_here(RUNS / name / "scene.toml", tmp_path / str(n), n, *flags)
        found.append(digests(tmp_path / str(n)))
    assert found[0] == found[1]
    rows = read_rows(tmp_path / "1" / "ledger.csv")
    last = max(row["step"] for row in rows)
    assert last > 10 and sum(row["particles"] for row in rows if row["step"] == last) > 1000
