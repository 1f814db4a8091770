"""The same bits with every coupling and every law, on one to three ranks and across a restart."""

import h5py
import numpy as np
import pytest

from tests.support.file_digests import digests, frame_digests
from tests.support.launch import go
from tests.support.simulated_runs import run_here
from tests.support.small_scenes import LAWS, SHARED, every_law, write
from vgmpi.commands import cli
from vgmpi.materials import registry

POOL = """
[domain]
size = [0.32, 0.16, 0.16]
cell = 0.01
[time]
end = 0.1
frames = 21
[accuracy]
pressure = "explicit"
precision = "single"

[material.water]
kind = "fluid"
max_speed = 2
[material.rubber]
kind = "elastic"
density = 500
youngs_modulus = 1e5
[[object]]
name = "column"
material = "water"
shape = { box = [[0, 0, 0], [0.12, 0.16, 0.12]] }
[[object]]
name = "toy"
material = "rubber"
shape = { sphere = { center = [0.2, 0.08, 0.04], radius = 0.035 } }
"""


def bits(scene, out, n, *flags, code=0, start=run_here):
    start(scene, out, n, *flags, code=code)
    return digests(out)


@pytest.mark.parametrize("precision", ["single", pytest.param("double", marks=pytest.mark.slow)])
def test_phases_that_share_space(precision, tmp_path):
    same_everywhere(write(tmp_path, SHARED.replace("PRECISION", precision)), tmp_path)


def test_colors_that_travel_with_every_step(tmp_path, capsys):
    """And AFLIP with every coupling."""
    text = SHARED.replace("PRECISION", "single")
    text = text.replace("[accuracy]", '[accuracy]\ntransfer = "aflip"')
    for name, color in {"pores": "#ff2010", "pool": "#1020ff", "jug": "#ffffff"}.items():
        text = text.replace(f'name = "{name}"', f'name = "{name}"\ncolor = "{color}"')
    looks = '[appearance]\ncolor_transfer = "step"\n[material.water]'
    scene = write(tmp_path, text.replace("[material.water]", looks))
    same_everywhere(scene, tmp_path)
    with h5py.File(sorted((tmp_path / "1").glob("frames/frame_*.vtkhdf"))[-1]) as frame:
        color = frame["VTKHDF/PointData/color_sh"][()]
        kinds = frame["VTKHDF/PointData/object"][()]
    assert not np.isnan(color[kinds == 2]).any() and np.isnan(color[kinds == 5]).all()
    assert (color[kinds == 2].std(axis=0) > 0.001).all()
    words = [str(scene), "-q", "-o", str(tmp_path / "half"), "--resume"]
    words += ["--set", "appearance.color_transfer=off"]
    assert cli.main(words) == 2
    assert "color_transfer: is 'off', in the run so far 'step'" in capsys.readouterr().err
    assert cli.main([*words, "--change"]) == 2
    printed = capsys.readouterr().err
    said = [line for line in printed.splitlines() if "checkpoint_" in line]
    assert len(said) == 1, printed
    assert "carries 5 numbers besides its motion, in this scene 2 (" in said[0]


def test_density_correction(tmp_path):
    same_everywhere(write(tmp_path, POOL), tmp_path)


def same_everywhere(scene, tmp_path):
    """Bits of all files on one rank, on three with two threads each, and after a restart."""
    want = bits(scene, tmp_path / "1", 1)
    assert sum("frame_" in name for name in want) > 20
    assert bits(scene, tmp_path / "3", 3, "--threads", 2) == want
    half = tmp_path / "half"
    bits(scene, half, 3, "--stop-after", "50 steps", code=75)
    found = bits(scene, half, 2, "--resume")
    frames = frame_digests(want)
    assert {name: found.get(name) for name in frames} == frames


@pytest.mark.mpi
def test_every_law(tmp_path):
    assert set(LAWS) == set(registry)
    scene = write(tmp_path, every_law("single"))
    want = bits(scene, tmp_path / "1", 1)
    for start, n in ((run_here, 2), (go, 3)):
        assert bits(scene, tmp_path / str(n), n, start=start) == want, n
