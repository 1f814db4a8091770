"""Scenes in which one number shows, to a probe or to a camera: what fits have to find again."""

from dataclasses import dataclass, replace

ROOM = """
[domain]
size = {size}
cell = {cell}
boundary = {walls}
gravity = {gravity}
[time]
end = {end}
frames = 13
[accuracy]
pressure = "explicit"
precision = "single"
"""
DOWN = [0, 0, -9.81]


@dataclass(frozen=True)
class Case:
    """A scene, what is looked for in it, its true value, range and first value, and what shows it:
    the columns of probe "it", or pictures of a camera (eye, target, field of view). grid: of the
    fit, "finer" where the room is too thin for larger cells."""

    scene: str
    key: str
    true: float
    range: tuple[float, float]
    initial: float
    columns: tuple[str, ...] = ()
    camera: tuple = ()
    grid: str = "coarser"


def room(size, cell, end, walls='"slip"', gravity=DOWN):
    return ROOM.format(size=size, cell=cell, end=end, walls=walls, gravity=gravity)


# a column that stands fast is pulled for a moment and swings along its axis
STIFFNESS = Case(
    room([0.08, 0.08, 0.28], 0.01, 0.12, '{ default = "slip", bottom = "stick" }', [0, 0, 0])
    + """
[material.rubber]
kind = "elastic"
youngs_modulus = 2e4
[[object]]
name = "column"
material = "rubber"
shape = { box = [[0.02, 0.02, 0], [0.06, 0.06, 0.2]] }
[[load]]
object = "column"
acceleration = [0, 0, 2]
[[probe]]
name = "it"
object = "column"
sampling_rate = 500
""",
    "material.rubber.youngs_modulus", 2e4, (2e3, 4e5), 2e5, ("center_z",),
)  # fmt: skip

# vortices in a box die out (Taylor and Green 1937)
VISCOSITY = Case(
    room([0.1, 0.05, 0.1], 0.00625, 0.25, gravity=[0, 0, 0])
    + """
[material.oil]
kind = "fluid"
density = 1000
tait_coefficient = 200
viscosity = 1
[[object]]
name = "oil"
material = "oil"
shape = { box = [[0, 0, 0], [0.1, 0.05, 0.1]] }
velocity_mode = [
    { amplitude = [0.005, 0, -0.005], wave_vector = [31.41592653589793, 0, 31.41592653589793] },
    { amplitude = [0.005, 0, 0.005], wave_vector = [31.41592653589793, 0, -31.41592653589793] },
]
[[probe]]
name = "it"
velocity = [0.05, 0.025, 0.0875]
sampling_rate = 400
""",
    "material.oil.viscosity", 1.0, (0.1, 10.0), 8.0, ("velocity_x",),
)  # fmt: skip

# a block that slides until it stops
FRICTION = Case(
    room([0.4, 0.16, 0.12], 0.01, 0.3,
         '{ default = "slip", bottom = { kind = "separate", friction = 0.3 } }')
    + """
[material.clay]
kind = "elastic"
youngs_modulus = 2e5
[[object]]
name = "block"
material = "clay"
color = "#b03010"
shape = { box = [[0.03, 0.04, 0], [0.11, 0.12, 0.04]] }
velocity = [0.8, 0, 0]
[[probe]]
name = "it"
object = "block"
sampling_rate = 200
""",
    "domain.boundary.bottom.friction", 0.3, (0.02, 1.5), 0.05, ("center_x", "velocity_x"),
)  # fmt: skip

# a block that is thrown down and does not get up again
YIELD = Case(
    room([0.2, 0.2, 0.16], 0.2 / 30, 0.05, gravity=[0, 0, 0])
    + """
[material.putty]
kind = "plasticine"
density = 1500
youngs_modulus = 5e5
yield_stress = 8e3
[[object]]
name = "block"
material = "putty"
color = "#b03010"
shape = { box = [[0.06, 0.06, 0.01], [0.14, 0.14, 0.13]] }
velocity = [0, 0, -3]
[[probe]]
name = "it"
object = "block"
sampling_rate = 5000
""",
    "material.putty.yield_stress", 8e3, (5e2, 1e5), 6e4, ("center_z", "velocity_z"),
)  # fmt: skip

# a column of sand that runs out between walls
ANGLE = Case(
    room([0.48, 0.08, 0.16], 0.01, 0.5, '{ default = "slip", bottom = "stick" }')
    + """
[material.grains]
kind = "sand"
youngs_modulus = 1e6
friction_angle = "32 deg"
[[object]]
name = "column"
material = "grains"
color = "#e8c860"
shape = { box = [[0, 0, 0], [0.1, 0.08, 0.14]] }
[[probe]]
name = "it"
object = "column"
sampling_rate = 100
""",
    "material.grains.friction_angle", 0.5585, (0.06, 1.1), 0.08, ("center_x", "center_z"),
)  # fmt: skip

# a slab that comes to float, twice as wide as high, between slipping walls
DENSITY = Case(
    room([0.4, 0.04, 0.32], 0.01, 0.8)
    + """
[material.water]
kind = "fluid"
tait_coefficient = 5e4
viscosity = 4
[material.wood]
kind = "elastic"
density = 500
youngs_modulus = 5e4
[[object]]
name = "slab"
material = "wood"
color = "#b03010"
shape = { box = [[0.08, 0, 0.12], [0.32, 0.04, 0.24]] }
[[object]]
name = "pool"
material = "water"
color = "#3060d0"
[[object.shape.difference]]
box = [[0, 0, 0], [0.4, 0.04, 0.16]]
[[object.shape.difference]]
box = [[0.08, 0, 0.12], [0.32, 0.04, 0.24]]
[[probe]]
name = "it"
object = "slab"
sampling_rate = 100
""",
    "material.wood.density", 500.0, (60.0, 950.0), 90.0, ("center_z",), grid="finer",
)  # fmt: skip

# sand full of water is pressed, and the water seeps out of it (Terzaghi)
PERMEABILITY = Case(
    room([0.08, 0.08, 0.48], 0.02, 0.3, gravity=[0, 0, 0])
    + """
[material.water]
kind = "fluid"
tait_coefficient = 1e6
[material.grains]
kind = "sand"
density = 2650
porosity = 0.4
youngs_modulus = 1.5e5
[[object]]
name = "pores"
material = "water"
shape = { box = [[0, 0, 0], [0.08, 0.08, 0.4]] }
volume_fraction = 0.4
[[object]]
name = "sand"
material = "grains"
shape = { box = [[0, 0, 0], [0.08, 0.08, 0.4]] }
[[load]]
object = "sand"
pressure = 500
face = "top"
ramp_time = 0.035
[[coupling]]
between = ["water", "grains"]
kind = "drag"
hydraulic_conductivity = 1e-2
[[probe]]
name = "it"
pressure = [0.04, 0.04, 0.02]
sampling_rate = 400
""",
    "coupling.0.hydraulic_conductivity", 1e-2, (1e-3, 0.2), 1e-1, ("pressure",),
)  # fmt: skip

# a block that jumps off the floor, to be seen
JUMP = Case(
    room([0.2, 0.2, 0.2], 0.01, 0.07, '{ default = "slip", bottom = "separate" }', [0, 0, 0])
    + """
[material.rubber]
kind = "elastic"
youngs_modulus = 2e4
[[object]]
name = "block"
material = "rubber"
color = "#b03010"
shape = { box = [[0.06, 0.06, 0.01], [0.14, 0.14, 0.13]] }
velocity = [0, 0, -1]
""",
    "material.rubber.youngs_modulus", 2e4, (2e3, 4e5), 2e5,
    camera=((0.1, -0.5, 0.15), (0.1, 0.1, 0.07), 20),
)  # fmt: skip

# vortices in oil of two colors
STIRRED = Case(
    room([0.1, 0.05, 0.1], 0.00625, 0.5, gravity=[0, 0, 0])
    + """
[material.oil]
kind = "fluid"
density = 1000
tait_coefficient = 1000
viscosity = 1
[[object]]
name = "left"
material = "oil"
color = "#b03010"
shape = { box = [[0, 0, 0], [0.05, 0.05, 0.1]] }
velocity_mode = [
    { amplitude = [0.1, 0, -0.1], wave_vector = [31.41592653589793, 0, 31.41592653589793] },
    { amplitude = [0.1, 0, 0.1], wave_vector = [31.41592653589793, 0, -31.41592653589793] },
]
[[object]]
name = "right"
material = "oil"
color = "#3060d0"
shape = { box = [[0.05, 0, 0], [0.1, 0.05, 0.1]] }
velocity_mode = [
    { amplitude = [0.1, 0, -0.1], wave_vector = [31.41592653589793, 0, 31.41592653589793] },
    { amplitude = [0.1, 0, 0.1], wave_vector = [31.41592653589793, 0, -31.41592653589793] },
]
""",
    "material.oil.viscosity", 1.0, (0.1, 10.0), 8.0,
    camera=((0.05, -0.4, 0.05), (0.05, 0.025, 0.05), 17),
)  # fmt: skip


def seen(case: Case, *camera) -> Case:
    """The same, told by pictures."""
    return replace(case, columns=(), camera=camera)


CASES = {
    "stiffness": STIFFNESS,
    "viscosity": VISCOSITY,
    "friction": FRICTION,
    "yield stress": YIELD,
    "friction angle": ANGLE,
    "density": DENSITY,
    "hydraulic_conductivity": PERMEABILITY,
    "stiffness, seen": JUMP,
    "viscosity, seen": STIRRED,
    "friction, seen": seen(FRICTION, (0.2, -0.8, 0.3), (0.2, 0.08, 0.03), 22),
    "yield stress, seen": seen(YIELD, (0.1, -0.5, 0.15), (0.1, 0.1, 0.06), 20),
    "friction angle, seen": seen(ANGLE, (0.24, -0.9, 0.2), (0.24, 0.04, 0.06), 24),
    "density, seen": seen(DENSITY, (0.2, -0.9, 0.2), (0.2, 0.02, 0.14), 22),
}
