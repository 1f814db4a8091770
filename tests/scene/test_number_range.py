"""Numbers of materials that single precision cannot compute with are refused by their line."""

import pytest

from tests.support.wrong_scenes import GOOD
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load

DENSITY, MODULUS = "density = 1000", 'youngs_modulus = "0.1 MPa"'
DOUBLE = 'frames = 11\n[accuracy]\nprecision = "double"'


def read(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    return load(path)


@pytest.mark.parametrize(
    "old, new, key, says",
    [
        (DENSITY, "density = 400e-100", "water.density", "is 4e-98 in SI units"),
        (DENSITY, 'density = "1e31 kg/m3"', "water.density", "is 1e+31 in SI units"),
        (DENSITY, "max_speed = 1e-40", "water", "is 1.42857e-76 in SI units"),
        (MODULUS, 'youngs_modulus = "1e30 MPa"', "rubber.youngs_modulus", "is 1e+36 in SI"),
    ],
)
def test_numbers_beyond_single_precision_are_refused(tmp_path, old, new, key, says):
    text = GOOD.replace(old, new)
    with pytest.raises(SceneError) as caught:
        read(tmp_path, text)
    lines = [line for line in caught.value.lines if says in line]
    assert len(lines) == 1 and f": material.{key}" in lines[0], caught.value.lines
    assert "single precision computes with numbers between 1e-30 and 1e+30" in lines[0]
    assert read(tmp_path, text.replace("frames = 11", DOUBLE)).accuracy.precision == "double"


def test_numbers_at_the_ends_are_read(tmp_path):
    for value in ("1e-30", "1e30"):
        read(tmp_path, GOOD.replace(DENSITY, f"density = {value}"))
