"""Presets of materials, and the ways to say how stiff a liquid is."""

import numpy as np
import pytest

from tests.support.small_scenes import scene
from vgmpi.materials import registry
from vgmpi.runtime.config.schema import SceneError

SCENE = """
[domain]
size = [0.64, 0.32, 0.32]
cell = 0.02
[time]
end = 1
[material.stuff]
KEYS
[[object]]
name = "block"
material = "stuff"
shape = { box = [[0, 0, 0], [0.1, 0.1, 0.1]] }
"""


def stuff(folder, keys):
    return scene(folder, SCENE.replace("KEYS", keys)).material["stuff"]


def complaint(folder, keys):
    """The one line said about it."""
    with pytest.raises(SceneError) as caught:
        stuff(folder, keys)
    assert len(caught.value.lines) == 1, caught.value.lines
    return caught.value.lines[0]


PRESETS = [(kind, name) for kind, cls in registry.items() for name in cls.presets]


@pytest.mark.parametrize("kind, name", PRESETS)
def test_a_preset_is_a_whole_material(kind, name, tmp_path):
    made = stuff(tmp_path, f'kind = "{kind}"\npreset = "{name}"')
    given = registry[kind].presets[name]
    assert {key: getattr(made, key) for key in given} == given
    assert all(np.isfinite(v) for v in made.law())


def test_keys_that_are_given_win_and_all_is_shown(tmp_path):
    keys = 'kind = "fluid"\npreset = "honey"\nviscosity = "5 Pa s"'
    shown = scene(tmp_path, SCENE.replace("KEYS", keys)).to_json()["material"]["stuff"]
    assert shown["preset"] == "honey"
    assert (shown["viscosity"], shown["density"], shown["tait_exponent"]) == (5.0, 1420.0, 7.0)


def test_an_unknown_preset_is_one_line(tmp_path):
    said = complaint(tmp_path, 'kind = "elastic"\npreset = "ruber"')
    assert "scene.toml:9: material.stuff.preset: there is no such preset" in said
    assert "(did you mean 'rubber'?); known here: rubber, silicone" in said and "'ruber'" in said
    assert "known here: water" in complaint(tmp_path, 'kind = "fluid"\npreset = 3')


def test_stiffness_by_the_fastest_motion(tmp_path):
    made = stuff(tmp_path, 'kind = "fluid"\ndensity = 900\nmax_speed = "3 m/s"')
    assert made.law().sound_speed_squared == pytest.approx(30.0**2)
    made = stuff(tmp_path, 'kind = "fluid"\nmax_speed = 3\nmax_compression = "4 %"')
    assert made.law().sound_speed_squared == pytest.approx((3 / 0.2) ** 2)
    # the table shows what follows
    assert made.model_dump()["tait_coefficient"] == pytest.approx(1000 * 225 / 7)


def test_stiffness_by_depth(tmp_path):
    """At the bottom the pressure rho g H compresses by the share allowed, to first order."""
    made = stuff(tmp_path, 'kind = "fluid"\nmax_depth = "2 m"\nmax_compression = "0.1 %"')
    law = made.law()
    J = (1 + 1000 * 9.81 * 2 / law.k) ** (-1 / law.gamma)
    assert 1 - J == pytest.approx(1e-3, rel=0.01)


@pytest.mark.parametrize("kind", ("fluid", "paste"))
def test_stiffness_is_given_once(kind, tmp_path):
    kind = {"fluid": 'kind = "fluid"', "paste": 'kind = "paste"\npreset = "mud"'}[kind]
    said = complaint(tmp_path, f"{kind}\ntait_coefficient = 1e5\nmax_speed = 3")
    assert "material.stuff.max_speed: tait_coefficient already says how stiff it is" in said
    assert "give one of tait_coefficient, max_speed or max_depth" in said
    assert "max_depth" in complaint(tmp_path, f"{kind}\nmax_speed = 1\nmax_depth = 3")
    said = complaint(tmp_path, f'{kind}\nmax_compression = "1 %"')
    assert "material.stuff.max_compression: needs max_speed or max_depth" in said
    assert "needs max_speed" in complaint(
        tmp_path, f"{kind}\ntait_coefficient=1e5\nmax_compression=0.01"
    )


@pytest.mark.parametrize("kind", ("fluid", "paste"))
def test_without_tension_the_volume_stays_below_that_at_rest(kind, tmp_path):
    keys = f'kind = "{kind}"' + ('\npreset = "jam"' if kind == "paste" else "")
    made = stuff(tmp_path, f'{keys}\ntension = "off"')
    law, rest = made.law(), tuple(v for values in made.carries.values() for v in values)
    grow = (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0)
    opened = type(made).advance(law, rest, grow, 0.1)
    assert opened[0] == 0.0
    assert abs(type(made).stress(law, opened, (0.0,) * 9)[0]) < 1e-9
    shrink = tuple(-v for v in grow)
    assert type(made).advance(law, rest, shrink, 0.1)[0] == pytest.approx(
        3 * np.log(0.9), abs=1.1e-3
    )
    free = stuff(tmp_path, keys)
    assert type(made).advance(free.law(), rest, grow, 0.1)[0] == pytest.approx(
        3 * np.log(1.1), abs=1.1e-3
    )
