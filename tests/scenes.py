"""Small scenes the tests run."""

from pathlib import Path

from vgmpi.scene import Scene, load

# every kind of wall, two fluids in one phase, two solids that meet each other, the fluids and a
# collider, fast enough to sort and migrate
MIXED = """
title = "mixed"

[domain]
size = [0.36, 0.24, 0.24]
cell = 0.02
boundary = { default = "slip", floor = "stick", east = { kind = "separate", friction = 0.2 } }

[time]
end = 0.06
frames = 4

[accuracy]
precision = "PRECISION"

[material.water]
kind = "fluid"
bulk_modulus = 5e4
viscosity = 0.01

[material.oil]
kind = "fluid"
density = 900
bulk_modulus = 5e4
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
spin = [0, 5, 0]

[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[-0.02, -0.02, 0], [0.02, 0.02, 0.1]] }
position = [0.28, 0.12, 0.0]

[output]
checkpoint_steps = 40
"""


def write(folder: Path, text: str) -> Path:
    """The scene file of this text in a folder."""
    path = Path(folder) / "scene.toml"
    path.write_text(text)
    return path


def scene(folder: Path, text: str) -> Scene:
    """The scene of this text; its files go to the folder."""
    return load(write(folder, text))
