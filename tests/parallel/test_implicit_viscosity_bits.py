"""An implicit viscosity has the same bits in every file for any number of ranks and threads, and
after a restart."""

import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)

# two liquids with velocity fields of their own, beside a paddle that sticks and a post that slips
TWO_LIQUIDS = """
[domain]
size = [0.48, 0.16, 0.32]
cell = 0.02
boundary = { default = "slip", west = "stick", north = "separate", top = "open" }
[time]
end = 0.1
frames = 3
[accuracy]
viscosity = "implicit"
precision = "PRECISION"
[material.honey]
kind = "fluid"
max_speed = 2
density = 1400
viscosity = 60
[material.oil]
kind = "fluid"
max_speed = 2
viscosity = 5
[[object]]
name = "left"
material = "honey"
phase = "honey"
subtract = true
shape = { box = [[0, 0, 0], [0.14, 0.16, 0.24]] }
[[object]]
name = "right"
material = "oil"
phase = "oil"
shape = { box = [[0.3, 0, 0], [0.48, 0.16, 0.2]] }
velocity = [-0.9, 0, 0]
subtract = true
[[object]]
name = "paddle"
role = "scenery"
collider = true
slip_length = 0
shape = { box = [[0.2, 0.04, -0.1], [0.26, 0.12, 0.1]] }
motion = { axis = [1, 2, 0], keyframes = [
  { time = "60 ms", translation = [-0.05, 0, 0] },
  { time = "155 ms", translation = [0.01, 0, 0.02], angle = "25 deg" },
] }
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { cylinder = { endpoints = [[0.4, 0.1, -0.1], [0.4, 0.1, 0.5]], radius = 0.03 } }
"""
# one liquid whose pressure is implicit, too
ONE_LIQUID = (
    TWO_LIQUIDS.replace('viscosity = "implicit"', 'viscosity = "implicit"\npressure = "implicit"')
    .replace('material = "oil"\nphase = "oil"', 'material = "honey"\nphase = "honey"')
    .replace("slip_length = 0\n", "")
)


@pytest.fixture(
    scope="module",
    params=[
        (TWO_LIQUIDS, "single"),
        pytest.param((TWO_LIQUIDS, "double"), marks=pytest.mark.slow),
        (ONE_LIQUID, "single"),
    ],
    ids=["two liquids", "two liquids, double", "implicit pressure"],
)
def one(request, tmp_path_factory):
    text, precision = request.param
    return run_on_one_rank(
        tmp_path_factory.mktemp("viscosity"), text.replace("PRECISION", precision)
    )


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, start, ranks, flags):
    assert_same_files(*one, tmp_path / "out", start, ranks, *flags)


def test_a_restart(one, tmp_path):
    assert_same_after_stop(*one, tmp_path / "out", 11)
