"""Small scenes the tests run."""

from pathlib import Path

from vgmpi.scene.loader import load
from vgmpi.scene.scene import Scene

# a room, and stuff for the objects that a test adds
WEIGHTLESS = """
[domain]
size = [0.2, 0.2, 0.2]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 1
"""
# a small rubber body in a room, beside the object that a test adds
PEBBLE = """
[domain]
size = [0.64, 0.64, 0.64]
cell = 0.02
[time]
end = 0.1
[material.rubber]
kind = "elastic"
density = 400
youngs_modulus = "0.1 MPa"
[[object]]
name = "pebble"
material = "rubber"
shape = { sphere = { center = [0.06, 0.06, 0.5], radius = 0.05 } }
"""
# a partner of a material "water", for an object that a test adds: a liquid, and grains
MIXES_WITH_MILK = """
[material.milk]
kind = "fluid"
[[coupling]]
kind = "mixing"
between = ["water", "milk"]
diffusivity = 0
"""
SEEPS_THROUGH_GRAINS = """
[material.grains]
kind = "sand"
[[coupling]]
kind = "drag"
between = ["water", "grains"]
hydraulic_conductivity = 1e-2
"""
ROOM = """
[accuracy]
precision = "double"
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.02
[time]
end = 1
[material.clay]
kind = "elastic"
density = 400
youngs_modulus = 1e5
"""
# in the middle of it
BALL = """
[[object]]
name = "ball"
material = "clay"
shape = { sphere = { center = [0.2, 0.2, 0.2], radius = 0.05 } }
"""

# every kind of wall, two fluids in one phase, two solids that meet each other, the fluids and a
# collider, fast enough to sort and migrate
MIXED = """
title = "mixed"

[domain]
size = [0.36, 0.24, 0.24]
cell = 0.02
boundary = { default = "slip", bottom = "stick", east = { kind = "separate", friction = 0.2 } }

[time]
end = 0.06
frames = 4

[accuracy]
pressure = "explicit"
precision = "PRECISION"

[material.water]
kind = "fluid"
tait_coefficient = 5e4
viscosity = 0.01

[material.oil]
kind = "fluid"
density = 900
tait_coefficient = 5e4
viscosity = 0.1

[material.rubber]
kind = "elastic"
density = 700
youngs_modulus = 2e5

[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.16, 0.24, 0.06]] }
position = [0.08, 0.12, 0]
velocity = [1.5, 0, 0]

[[object]]
name = "slick"
material = "oil"
shape = { box = [[0, 0, 0], [0.16, 0.24, 0.04]] }
position = [0.08, 0.12, 0.06]
velocity = [1.5, 0, 0]

[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0, 0, 0], radius = 0.045 } }
position = [0.1, 0.12, 0.11]
velocity = [2, 0, -1]

[[object]]
name = "cube"
material = "rubber"
shape = { box = [[-0.04, -0.04, 0], [0.04, 0.04, 0.08]] }
position = [0.2, 0.1, 0.12]
velocity = [-2, 0, 0]
angular_velocity = [0, 5, 0]

[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[-0.02, -0.02, 0], [0.02, 0.02, 0.1]] }
position = [0.28, 0.12, 0.0]

[output]
checkpoint_interval_steps = 40
"""

# everything that phases can do to each other: three liquids that mix, two of them in the pores of
# sand, a toy that meets all of them; another liquid apart; fast enough to sort and migrate
SHARED = """
title = "shared"

[domain]
size = [0.36, 0.24, 0.24]
cell = 0.02
gravity = [0, 0, -9.80665]

[time]
end = 0.05
frames = 3

[accuracy]
pressure = "explicit"
precision = "PRECISION"

[material.water]
kind = "fluid"
tait_coefficient = 5e4

[material.milk]
kind = "fluid"
density = 1030
tait_coefficient = 5e4
viscosity = 0.01

[material.syrup]
kind = "fluid"
density = 1300
tait_coefficient = 5e4
viscosity = 1

[material.grains]
kind = "sand"
youngs_modulus = 1e5

[material.toy]
kind = "elastic"
density = 700
youngs_modulus = 1e5

[[object]]
name = "pores"
material = "water"
shape = { box = [[0, 0, 0], [0.2, 0.24, 0.06]] }
volume_fraction = 0.4
velocity = [0.4, 0, 0]

[[object]]
name = "bed"
material = "grains"
shape = { box = [[0, 0, 0], [0.2, 0.24, 0.06]] }

[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0.06], [0.16, 0.24, 0.12]] }
velocity = [1.5, 0, 0]

[[object]]
name = "jug"
material = "milk"
shape = { box = [[0.16, 0, 0.06], [0.28, 0.24, 0.14]] }
velocity = [-1.5, 0, 0]

[[object]]
name = "jar"
material = "syrup"
shape = { box = [[0.2, 0.08, 0], [0.34, 0.24, 0.06]] }
velocity = [-1, 0, 0]

[[object]]
name = "ball"
material = "toy"
shape = { sphere = { center = [0.1, 0.12, 0.16], radius = 0.045 } }
velocity = [1, 0, -2]

[[coupling]]
between = ["water", "milk"]
kind = "mixing"
diffusivity = 1e-3
slip_relaxation_time = 0.01

[[coupling]]
between = ["syrup", "milk"]
kind = "mixing"
diffusivity = 1e-3
slip_relaxation_time = 0.01

[[coupling]]
between = ["water", "grains"]
kind = "drag"
hydraulic_conductivity = 1e-2

[[coupling]]
between = ["milk", "grains"]
kind = "drag"
hydraulic_conductivity = 2e-2

[output]
checkpoint_interval_steps = 40
"""

# a small ball of every law, falling onto each other in three heaps
LAWS = {
    "fluid": "tait_coefficient = 3e4",
    "paste": 'preset = "ketchup"\nshear_modulus = 3e3',
    "sand": "youngs_modulus = 1e5",
    "snow": "youngs_modulus = 1e5",
    "elastic": "youngs_modulus = 1e5",
    "corotated": "youngs_modulus = 1e5",
    "metal": "youngs_modulus = 1e6\nyield_stress = 2e3",
    "foam": 'preset = "shaving foam"',
    "plasticine": "youngs_modulus = 1e5\nyield_stress = 1e3\ndensity = 1500",
}


def every_law(precision: str) -> str:
    """The text of a scene in which balls of all laws collide: three side by side, and as many upon
    each other as it takes.
    """
    rows = -(-len(LAWS) // 3)
    cells = -(-(35 + 55 * rows) // 20)  # of 20 mm: 55 mm a row, and 35 mm
    text = f"""
[domain]
size = [0.3, 0.2, {cells * 0.02}]
cell = 0.02
[time]
end = 0.04
frames = 2
[accuracy]
precision = "{precision}"
"""
    for k, (kind, keys) in enumerate(LAWS.items()):
        x, y, z = 0.05 + 0.1 * (k % 3), 0.1, 0.04 + 0.055 * (k // 3)
        text += f"""
[material.{kind}]
kind = "{kind}"
{keys}
[[object]]
name = "ball of {kind}"
material = "{kind}"
shape = {{ sphere = {{ center = [{x}, {y}, {z}], radius = 0.032 }} }}
velocity = [{2 - 2 * (k % 3)}, 0, {-2 * (k // 3)}]
"""
    return text


def write(folder: Path, text: str) -> Path:
    """The scene file of this text in a folder."""
    path = Path(folder) / "scene.toml"
    path.write_text(text)
    return path


def scene(folder: Path, text: str) -> Scene:
    """The scene of this text; its files go to the folder."""
    return load(write(folder, text))
