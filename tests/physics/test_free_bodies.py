"""Free rigid bodies: on floors, among each other, and in what flows.

References: momentum and angular momentum are exact; a ball rolls down a slope with 5/7 g sin a and
slides with g (sin a - mu cos a) while it spins up with 5/2 mu g cos a / R; it rebounds to e^2 of
its height; blocks that lie on each other stay; a body without torque keeps energy and angular
momentum while it tumbles (Dzhanibekov). In a liquid the added mass holds, as in test_sphere.py, and
what was at rest stays.
"""

import numpy as np
import pytest

import tests.physics.test_sphere as sphere
from tests.support.simulate import begin, by_id, conservation_rows
from tests.support.validation_record import held
from vgmpi.features.rigid_bodies.free_bodies import FreeBodies

G = 9.81
FLOOR = """
[accuracy]
pressure = "explicit"
[domain]
size = [{long}, 0.2, 0.6]
cell = 0.01
gravity = [{along}, 0, {down}]
boundary = {{ default = "slip", bottom = {{ kind = "separate", friction = {mu} }} }}
[time]
end = 10
dt = {dt}
[material.dust]
kind = "elastic"
youngs_modulus = 500
[material.wood]
kind = "elastic"
density = 700
youngs_modulus = 1e6
friction = {mu}
[[object]]
name = "speck"
material = "dust"
shape = {{ box = [[0.0, 0.18, 0.0], [0.02, 0.2, 0.02]] }}
{bodies}
"""
BODY = """
[[object]]
name = "body{k}"
material = "wood"
rigid = true
restitution = {bounce}
shape = {{ {shape} }}
"""
SPLASH = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.01
gravity = [0, 0, 0]
[time]
end = 10
[accuracy]
pressure = "explicit"
precision = "double"
volume_correction = "none"
[material.drop]
kind = "{kind}"
{more}
[material.wood]
kind = "elastic"
density = 600
youngs_modulus = 1e6
friction = 0.4
[[object]]
name = "drop"
material = "drop"
shape = {{ sphere = {{ center = [0.12, 0.2, 0.2], radius = 0.06 }} }}
velocity = [2, 0.3, 0]
[[object]]
name = "block"
material = "wood"
rigid = true
shape = {{ box = [[0.2, 0.15, 0.14], [0.26, 0.24, 0.26]] }}
rotation = {{ axis = "z", angle = "20 deg" }}
angular_velocity = [0, 1, 2]
"""


def on_floor(folder, shapes, slope=0.0, mu=0.5, bounce=0.0, dt=1e-3, long=0.2):
    """(simulation, its free bodies) of bodies of some shapes on the floor of a tilted domain."""
    bodies = "".join(BODY.format(k=k, bounce=bounce, shape=s) for k, s in enumerate(shapes))
    text = FLOOR.format(
        long=long, along=G * np.sin(slope), down=-G * np.cos(slope), mu=mu, dt=dt, bodies=bodies
    )
    simulation, _ = begin(folder, text)
    return simulation, simulation.features["rigid_bodies"].bodies


def ball(x, z, radius=0.06):
    return f"sphere = {{ center = [{x}, 0.1, {z}], radius = {radius} }}"


@pytest.mark.parametrize("mu", [0.5, 0.05])
def test_a_ball_on_a_slope(tmp_path, mu):
    slope = np.radians(20.0)
    simulation, bodies = on_floor(tmp_path, [ball(0.2, 0.06)], slope, mu, long=2.0)
    for _ in range(400):
        simulation.advance(1e-3)
    time, rolls = simulation.time, mu > 2 / 7 * np.tan(slope)
    rate = G * 5 / 7 * np.sin(slope) if rolls else G * (np.sin(slope) - mu * np.cos(slope))
    spin = rate / 0.06 if rolls else 2.5 * mu * G * np.cos(slope) / 0.06
    name = f"rigid ball that {'rolls' if rolls else 'slides'} down a slope"
    source = "rigid bodies: mechanics of a solid ball"
    held(f"{name}: acceleration", bodies.v[0, 0] / time, rate, 1e-3, unit="m/s2", source=source)
    held(f"{name}: angular acceleration", bodies.v[0, 4] / time, spin, 1e-3, unit="rad/s2",
         source=source)  # fmt: skip
    assert abs(bodies.x[0, 2] - 0.06) < 1e-5


def test_a_stack_stays(tmp_path):
    """Five blocks, for two seconds."""
    shapes = [
        f"box = [[0.06, 0.06, {0.06 * k:.2f}], [0.14, 0.14, {0.06 * k + 0.06:.2f}]]"
        for k in range(5)
    ]
    simulation, bodies = on_floor(tmp_path, shapes)
    start = bodies.x.copy()
    for _ in range(2000):
        simulation.advance(1e-3)
    held("stack of five rigid blocks: way", float(np.abs(bodies.x - start).max() / 0.01), 0.0, 1e-3,
         kind="below", unit="cells", source="statics", note="2 s")  # fmt: skip
    assert np.abs(bodies.v[:, :3]).max() < 1e-6


@pytest.mark.parametrize(("bounce", "dt"), [(1.0, 2e-4), (0.8, 1e-4), (0.5, 4e-5)])
def test_a_ball_rebounds(tmp_path, bounce, dt):
    """Three times. An impact is at the beginning of a step: heights are of the first order."""
    simulation, bodies = on_floor(tmp_path, [ball(0.1, 0.26)], mu=0.0, bounce=bounce, dt=dt)
    height, fall = [], np.sqrt(2 * 0.2 / G)
    third = fall * (1 + 2 * bounce + 2 * bounce**2 + bounce**3)
    while simulation.time < third + 0.3 * fall * bounce**3:
        simulation.advance(dt)
        height.append(bodies.x[0, 2] - 0.06)
    z = np.array(height)
    tops = np.flatnonzero((z[1:-1] > z[:-2]) & (z[1:-1] >= z[2:])) + 1
    assert len(tops) == 3
    for k, top in enumerate(tops, 1):
        held(f"rigid ball that rebounds, e = {bounce:g}: height after bounce {k}",
             float(z[top] / 0.2), bounce ** (2 * k), 0.01, source="e^2 of the height",
             note=f"time step {dt:g} s")  # fmt: skip


def test_a_body_that_tumbles(tmp_path):
    """About its middle axis, which is unstable, for a hundred turns."""
    _, bodies = on_floor(tmp_path, ["box = [[0.02, 0.05, 0.2], [0.18, 0.15, 0.23]]"])
    assert isinstance(bodies, FreeBodies)
    middle = np.argsort(np.diag(bodies.inertia[0]))[1]
    bodies.v[0, 3:] = 0.01
    bodies.v[0, 3 + middle] = 10.0
    bodies.spin[0] = bodies.inertia[0] @ bodies.v[0, 3:]
    start, energy, turned = bodies.spin.copy(), bodies.spin[0] @ bodies.v[0, 3:], []
    for _ in range(63000):
        bodies.move(1e-3)
        turned.append(bodies.rotations()[0, middle, middle])
    assert np.array_equal(bodies.spin, start)
    assert min(turned) < -0.9, "it does not tumble"
    held("rigid body without torque: energy after 100 turns",
         float(bodies.spin[0] @ bodies.v[0, 3:] / energy), 1.0, 1e-3,
         source="conservation")  # fmt: skip


@pytest.mark.slow
def test_a_body_that_tumbles_in_steps_of_the_solver(tmp_path):
    """The same with all that a step does, a hundred turns without gravity."""
    shape = "box = [[0.04, 0.0625, 0.2], [0.16, 0.1375, 0.2225]]"
    simulation, bodies = on_floor(tmp_path, [shape], dt=5e-3)
    simulation.gravity = np.zeros(3)
    middle = np.argsort(np.diag(bodies.inertia[0]))[1]
    bodies.v[0, 3:] = 0.01
    bodies.v[0, 3 + middle] = 10.0
    bodies.spin[0] = bodies.inertia[0] @ bodies.v[0, 3:]
    start, energy, turned = bodies.spin.copy(), bodies.spin[0] @ bodies.v[0, 3:], []
    while simulation.time < 100 * 2 * np.pi / 10:
        simulation.advance(5e-3)
        turned.append(bodies.rotations()[0, middle, middle])
    bodies.set_velocities()
    assert min(turned) < -0.9, "it does not tumble"
    held("rigid body without torque in the solver: angular momentum",
         float(np.abs(bodies.spin - start).max() / np.abs(start).max()), 0.0, 1e-12,
         kind="absolute", source="conservation", note="100 turns")  # fmt: skip
    held("rigid body without torque in the solver: energy after 100 turns",
         float(bodies.spin[0] @ bodies.v[0, 3:] / energy), 1.0, 1e-3,
         source="conservation")  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("fluid", "tait_coefficient = 2e4"),
        ("sand", "youngs_modulus = 1e5"),
        ("elastic", "youngs_modulus = 1e4"),
        ("fluid", "viscosity = 5"),
    ],
)
def test_momentum_and_angular_momentum_of_a_collision(tmp_path, kind, more):
    """A drop hits a tilted block that turns, in free space."""
    text = SPLASH.format(kind=kind, more=more)
    if "viscosity" in more:
        kind = "honey that sticks"
        text = text.replace("rigid = true", "rigid = true\nslip_length = 0")
    simulation, _ = begin(tmp_path, text)
    bodies = simulation.features["rigid_bodies"].bodies
    start, before = totals(simulation), bodies.momentum.copy()
    while simulation.time < 0.07:
        simulation.advance(simulation.bound())
    end = totals(simulation)
    scale = np.abs(start[0]).max()
    assert np.abs(bodies.momentum - before).max() > 0.1 * scale, "it was not hit"
    for k, (name, arm) in enumerate((("momentum", 1.0), ("angular momentum", 0.2))):
        error = float(np.abs(end[k] - start[k]).max() / (arm * scale))
        held(f"rigid block hit by a drop ({kind}): {name}", error, 0.0, 1e-12, kind="absolute",
             source="conservation", note="double precision")  # fmt: skip


def totals(simulation):
    """Momentum and angular momentum, (3,) each, of particles and rigid bodies."""
    bodies, density = simulation.features["rigid_bodies"].bodies, simulation.plan.groups[0].density
    x, v, C, volume = by_id(simulation, "x", "v", "C", "vol0")
    m, C = density * volume[:, None], C.reshape(-1, 3, 3)
    own = np.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], 1)
    angular = (m * (np.cross(x, v) + simulation.plan.dx**2 / 4 * own)).sum(0)
    angular += (bodies.spin + np.cross(bodies.x, bodies.momentum)).sum(0)
    return (m * v).sum(0) + bodies.momentum.sum(0), angular


def ledger_sums(simulation):
    """By name of the column: the sum over the rows of the ledger."""
    rows = conservation_rows(simulation)
    return {name: sum(row[name] for row in rows) for name in rows[0] if "_" in name}


def test_energy_of_a_body_that_falls_and_spins_in_the_ledger(tmp_path):
    """m (g t)^2 / 2 and L^2 / (2 I) of a box about one of its principal axes.

    I is that of the body: its samples give it to 1e-3.
    """
    simulation, bodies = on_floor(tmp_path, ["box = [[0.02, 0.05, 0.3], [0.18, 0.15, 0.34]]"])
    mass = 700 * 0.16 * 0.1 * 0.04
    spin, inertia = 2e-3, float(bodies.inertia[0, 1, 1])
    assert inertia == pytest.approx(mass * (0.16**2 + 0.04**2) / 12, rel=1e-3)
    bodies.spin[0, 1] = spin
    bodies.set_velocities()
    start = ledger_sums(simulation)
    for _ in range(100):
        simulation.advance(1e-3)
    sums, spinning = ledger_sums(simulation), 0.5 * spin**2 / inertia
    assert start["rigid_kinetic_energy"] == pytest.approx(spinning, rel=1e-12)
    assert start["rigid_potential_energy"] == pytest.approx(mass * G * 0.32, rel=1e-12)
    assert sums["rigid_kinetic_energy"] == pytest.approx(
        0.5 * mass * (0.1 * G) ** 2 + spinning, rel=1e-9
    )
    # x moves by the velocity at the end of a step: it falls by g t (t + dt) / 2
    assert sums["rigid_potential_energy"] == pytest.approx(
        mass * G * (0.32 - 0.5 * G * 0.1 * 0.101), rel=1e-12
    )
    assert sums["rigid_momentum_z"] == pytest.approx(-mass * G * 0.1, rel=1e-12)
    assert sums["rigid_angular_momentum_y"] == pytest.approx(spin + 0.1 * mass * G * 0.1, rel=1e-9)


def test_momentum_in_the_ledger_stays(tmp_path):
    """Of water that hits a block, with that of the block."""
    simulation, _ = begin(tmp_path, SPLASH.format(kind="fluid", more="tait_coefficient = 2e4"))
    names = [f"{kind}momentum_{a}" for kind in ("", "angular_") for a in "xyz"]

    def totals():
        sums = ledger_sums(simulation)
        return np.array([sums[name] + sums[f"rigid_{name}"] for name in names])

    start, before = totals(), ledger_sums(simulation)["rigid_momentum_x"]
    while simulation.time < 0.05:
        simulation.advance(simulation.bound())
    assert ledger_sums(simulation)["rigid_momentum_x"] - before > 0.01 * start[0], "it was not hit"
    error = np.abs(totals() - start)
    assert error[:3].max() < 1e-12 * np.abs(start[:3]).max()
    assert error[3:].max() < 1e-12 * 0.2 * np.abs(start[:3]).max()


def in_water(folder, ratio, g=0.0, speed=0.0):
    """(simulation, its bodies) of a rigid ball, 8 cells in radius, in the middle of a box."""
    text = sphere.SCENE.format(
        L=sphere.L, dx=sphere.DX, g=-g, density=1000 * ratio, stiff=1e5, m=sphere.L / 2, R=0.08,
        pressure='initial_pressure = "hydrostatic"' if g else "",
    )  # fmt: skip
    rigid = f'material = "rubber"\nrigid = true\nvelocity = [{speed}, 0, 0]\n'
    simulation, _ = begin(folder, text.replace('material = "rubber"\n', rigid, 1))
    return simulation, simulation.features["rigid_bodies"].bodies


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.01, 0.1, 0.5, 2.0, 10.0, 100.0])
def test_it_is_let_go(tmp_path, ratio):
    simulation, bodies = in_water(tmp_path, ratio, g=G)
    start = bodies.x[0, 2]
    while abs(bodies.x[0, 2] - start) < 0.5 * 0.08:
        simulation.advance(simulation.bound())
    found = 2 * float(bodies.x[0, 2] - start) / simulation.time**2
    exact = -(ratio - 1) * G / (ratio + sphere.added_mass(8))
    held(f"rigid sphere released, density {ratio:g}: acceleration", found, exact, 0.12, unit="m/s2",
         source="Lamb, art. 93", note="8 cells in radius, over half a radius")  # fmt: skip


@pytest.mark.slow
def test_it_coasts(tmp_path):
    simulation, bodies = in_water(tmp_path, 3.0, speed=0.3)
    start, speeds = bodies.x[0, 0], []
    while bodies.x[0, 0] - start < 0.08:
        simulation.advance(simulation.bound())
        if bodies.x[0, 0] - start > 0.008:
            speeds.append(bodies.v[0, 0])
    held("rigid sphere that coasts: speed", float(np.mean(speeds)) / 0.3,
         3 / (3 + sphere.added_mass(8)), 0.06, source="Lamb, art. 93; d'Alembert",
         note="3 times as dense as water, 8 cells in radius, over a radius")  # fmt: skip


@pytest.mark.slow
def test_water_at_rest_around_it_stays_at_rest(tmp_path):
    """As dense as the water around its center, for two seconds.

    The water is soft: with p = k (J^-7 - 1) it is 1.4 % denser there than without pressure, and a
    ball of 1000 kg/m3 rises.
    """
    stiffness, depth = 2e4, sphere.L / 2
    compression = 1 + (6 / 7) * 1000 * G * depth / stiffness  # J^-6 from dp/dz = -rho g / J
    simulation, bodies = in_water(tmp_path, compression ** (1 / 6), g=G)
    start = bodies.x.copy()
    while simulation.time < 2.0:
        simulation.advance(simulation.bound())
    (v,) = by_id(simulation, "v")
    rms = float(np.sqrt((v**2).sum(1).mean() / (G * 0.08)))
    print(f"way {(bodies.x - start)[0] / sphere.DX} cells")
    held("water at rest around a neutral rigid sphere: rms speed", rms, 0.0, 0.005, kind="absolute",
         unit="sqrt(g R)", source="hydrostatics", note="8 cells in radius, after 2 s")  # fmt: skip
    assert np.abs(bodies.x - start).max() < 0.5 * sphere.DX
