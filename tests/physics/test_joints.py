"""Joints of free rigid bodies.

References: a compound pendulum of any amplitude (elliptic integral); torque and force by Newton's
law; a mass on a spring. The ends of a joint stay together where the masses differ by a hundred.
"""

import numpy as np
import pytest
from scipy.special import ellipk

from tests.support.simulate import begin
from tests.support.small_scenes import scene
from tests.support.validation_record import held
from vgmpi.solver.diagnostics.probe_sampling import Probes

G, DX = 9.81, 0.02
SCENE = """
[domain]
size = [1.2, 0.2, 1.2]
cell = 0.02
gravity = [0, 0, {gravity}]
[time]
end = 10
dt = 1e-3
[material.dust]
kind = "elastic"
youngs_modulus = 1000
[material.wood]
kind = "elastic"
density = 700
youngs_modulus = 1e6
friction = 0.5
[material.iron]
kind = "elastic"
density = {heavy}
youngs_modulus = 1e6
[[object]]
name = "speck"
material = "dust"
shape = {{ box = [[0.0, 0.16, 0.0], [0.04, 0.2, 0.04]] }}
{bodies}
{joints}
"""


def box(name, low, high, more="", material="wood"):
    """Table of a rigid box."""
    return (
        f'[[object]]\nname = "{name}"\nmaterial = "{material}"\nrigid = true\n{more}\n'
        f"shape = {{ box = [{list(low)}, {list(high)}] }}\n"
    )


def joint(kind, between, at, more=""):
    """Table of a joint."""
    return f'[[joint]]\nkind = "{kind}"\nbetween = {list(between)}\nat = {list(at)}\n{more}\n'


ROD = box("rod", (0.6, 0.09, 0.58), (0.84, 0.11, 0.62))
PIVOT = (0.6, 0.1, 0.6)


def jointed(folder, bodies, joints, gravity=-G, heavy=7000):
    """(simulation, its free bodies, its joints) of bodies in a box."""
    text = SCENE.format(gravity=gravity, heavy=heavy, bodies=bodies, joints=joints)
    simulation, _ = begin(folder, text)
    return (
        simulation,
        simulation.features["rigid_bodies"].bodies,
        simulation.features["rigid_bodies"].joints,
    )


def distances(joints):
    """Largest distance of the two ends of a joint [m], or its turn that should not be."""
    return float(np.abs(joints.errors).max())


def crossings(time, value):
    """Times at which samples change their sign."""
    k = np.flatnonzero((value[1:] > 0) != (value[:-1] > 0))
    return time[k] - value[k] * (time[k + 1] - time[k]) / (value[k + 1] - value[k])


def test_a_pendulum(tmp_path):
    """From the horizontal, for two periods."""
    simulation, bodies, joints = jointed(
        tmp_path, ROD, joint("hinge", ["rod"], PIVOT, 'axis = "y"')
    )
    arm = float(bodies.x[0, 0] - PIVOT[0])
    inertia = bodies.inertia[0, 1, 1] + bodies.mass[0] * arm**2
    period = 4 * np.sqrt(inertia / (bodies.mass[0] * G * arm)) * ellipk(0.5)
    time, angle, apart = [], [], 0.0
    while simulation.time < 2.05 * period:
        simulation.advance(1e-3)
        time.append(simulation.time)
        angle.append(np.arctan2(bodies.x[0, 0] - PIVOT[0], PIVOT[2] - bodies.x[0, 2]))
        apart = max(apart, distances(joints))
    zero = crossings(np.array(time), np.array(angle))
    held("rigid pendulum on a hinge from 90 degrees: period", float(zero[2] - zero[0]), period,
         1e-4, unit="s", source="elliptic integral", note="dt 1 ms")  # fmt: skip
    held("rigid pendulum on a hinge: amplitude after two periods", max(angle[-200:]) / (np.pi / 2),
         1.0, 1e-4, source="conservation of energy")  # fmt: skip
    assert apart < 1e-4 * DX
    assert abs(joints.coordinate[0] - (np.pi / 2 - angle[-1])) < 0.02  # of the step before


def test_a_motor(tmp_path):
    """It turns a rod by its largest torque until it has its speed."""
    more = 'axis = "y"\nmotor = { speed = 10, torque = 2 }'
    simulation, bodies, joints = jointed(
        tmp_path, ROD, joint("hinge", ["rod"], (0.72, 0.1, 0.6), more), 0
    )
    rise = 10 * float(bodies.inertia[0, 1, 1]) / 2
    dt = rise / 100
    for _ in range(50):
        simulation.advance(dt)
    held("motor of a hinge at its largest torque: speed", float(bodies.v[0, 4]), 5.0, 1e-6,
         unit="rad/s", source="Newton")  # fmt: skip
    for _ in range(100):
        simulation.advance(dt)
    held("motor of a hinge without load: speed", float(bodies.v[0, 4]), 10.0, 1e-6, unit="rad/s",
         source="its speed")  # fmt: skip
    assert abs(joints.coordinate[0] - (rise * 5 + 50 * dt * 10)) < 20 * dt  # turns are counted
    assert np.abs(bodies.x[0] - (0.72, 0.1, 0.6)).max() < 1e-9


def test_a_motor_of_a_slider_lifts(tmp_path):
    """Its force is larger than the weight by a known amount."""
    more = 'axis = "z"\nmotor = { speed = 100, force = 2 }'
    simulation, bodies, _ = jointed(tmp_path, ROD, joint("slider", ["rod"], PIVOT, more))
    for _ in range(100):
        simulation.advance(1e-3)
    rate = 2 / float(bodies.mass[0]) - G
    held("motor of a slider: acceleration against the weight", float(bodies.v[0, 2]) / 0.1, rate,
         1e-6, unit="m/s2", source="Newton")  # fmt: skip


def test_a_slider(tmp_path):
    """Down a slope of 30 degrees, pulled beside its center of mass."""
    slope = np.radians(30)
    axis = [float(np.cos(slope)), 0.0, -float(np.sin(slope))]
    simulation, bodies, joints = jointed(
        tmp_path, ROD, joint("slider", ["rod"], (0.6, 0.1, 0.7), f"axis = {axis}")
    )
    start = bodies.x[0].copy()
    for _ in range(300):
        simulation.advance(1e-3)
    held("slider on a slope of 30 degrees: speed", float(bodies.v[0, :3] @ axis), G * 0.5 * 0.3,
         1e-6, unit="m/s", source="g sin(a) t")  # fmt: skip
    way = bodies.x[0] - start
    assert np.abs(way - (way @ axis) * np.array(axis)).max() < 1e-12
    assert np.abs(bodies.v[0, 3:]).max() < 1e-12 and distances(joints) < 1e-12


@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_a_mass_on_a_spring(tmp_path, damping):
    """It starts without tension, at the end of its swing."""
    stiffness = 40.0
    more = f"to = [0.72, 0.1, 1.0]\nstiffness = {stiffness}\ndamping = {damping}"
    simulation, bodies, _ = jointed(tmp_path, ROD, joint("spring", ["rod"], (0.72, 0.1, 0.6), more))
    mass, start = float(bodies.mass[0]), float(bodies.x[0, 2])
    rate = np.sqrt(stiffness / mass - (damping / (2 * mass)) ** 2)
    period, sag = 2 * np.pi / rate, mass * G / stiffness
    time, z = [], []
    while simulation.time < 2.05 * period:
        simulation.advance(1e-3)
        time.append(simulation.time)
        z.append(bodies.x[0, 2] - start + sag)
    zero = crossings(np.array(time), np.array(z))
    name = "mass on a spring" + (" with a damper" if damping else "")
    held(f"{name}: period", float(zero[2] - zero[0]), period, 2e-3 if damping else 1e-4,
         unit="s", source="oscillator")  # fmt: skip
    top = max(z[-200:]) / sag
    exact = float(np.exp(-damping / (2 * mass) * 2 * period))
    held(f"{name}: amplitude after two periods", top, exact, 2e-3, source="oscillator",
         note="dt 1 ms")  # fmt: skip


def test_a_stiff_spring_is_stable(tmp_path):
    """Stiffer than explicit steps could be, by a thousand."""
    more = "to = [0.72, 0.1, 1.0]\nstiffness = 1e9"
    simulation, bodies, _ = jointed(tmp_path, ROD, joint("spring", ["rod"], (0.72, 0.1, 0.6), more))
    for _ in range(300):
        simulation.advance(1e-3)
    assert np.abs(bodies.x[0] - (0.72, 0.1, 0.6)).max() < 1e-4 * DX


def test_a_chain_with_a_heavy_end(tmp_path):
    """Ten rods that fall from the horizontal, with a hundred times the mass of one at the end."""
    bodies, joints, names = "", "", []
    for k in range(10):
        x = round(0.2 + 0.06 * k, 3)
        bodies += box(f"rod{k}", (x, 0.08, 0.86), (round(x + 0.06, 3), 0.12, 0.90))
        names.append(f"rod{k}")
        joints += joint("ball", names[-2:] if k else names[-1:], (x, 0.1, 0.88))
    bodies += box("end", (0.8, 0.06, 0.84), (0.88, 0.14, 0.92), material="iron")
    joints += joint("ball", ["rod9", "end"], (0.8, 0.1, 0.88))
    volume = (0.06 * 0.04 * 0.04, 0.08**3)
    simulation, bodies, system = jointed(
        tmp_path, bodies, joints, heavy=700 * 100 * volume[0] / volume[1]
    )
    assert bodies.mass[-1] / bodies.mass[0] == pytest.approx(100, rel=1e-2)
    assert len(system.groups) == 2
    apart, low = 0.0, 1.0
    for _ in range(500):
        simulation.advance(1e-3)
        apart, low = max(apart, distances(system)), min(low, bodies.x[-1, 2])
    held("chain of ten rods with 100 times their mass at its end: ends of joints apart",
         apart / DX, 0.0, 1e-3, kind="absolute", unit="cells", source="no motion",
         note="0.5 s, dt 1 ms")  # fmt: skip
    assert low < 0.5, "it did not fall"


def test_limits(tmp_path):
    """A rod falls on its limit, rests there, and comes back when gravity changes its side."""
    more = 'axis = "y"\nlimits = ["-10 deg", "20 deg"]'
    simulation, bodies, joints = jointed(tmp_path, ROD, joint("hinge", ["rod"], PIVOT, more))
    angle = []
    for k in range(600):
        if k == 300:
            simulation.gravity = -simulation.gravity
        simulation.advance(1e-3)
        angle.append(np.degrees(joints.coordinate[0]))
    assert max(angle) < 20.001 and min(angle) > -10.001
    assert angle[299] == pytest.approx(20, abs=1e-3) and angle[-1] == pytest.approx(-10, abs=1e-3)
    assert np.abs(bodies.v).max() < 1e-6


def test_a_limit_of_a_slider(tmp_path):
    more = 'axis = "z"\nlimits = ["-5 cm", "20 cm"]'
    simulation, bodies, joints = jointed(tmp_path, ROD, joint("slider", ["rod"], PIVOT, more))
    for _ in range(300):
        simulation.advance(1e-3)
    assert bodies.x[0, 2] == pytest.approx(0.55, abs=1e-6)
    assert joints.rows.impulse[-1] / 1e-3 == pytest.approx(bodies.mass[0] * G, rel=1e-9)


def test_a_closed_loop(tmp_path):
    """Four bars, whose hinges repeat each other: the parallelogram swings as a pendulum."""
    bars = box("a", (0.4, 0.08, 0.4), (0.44, 0.1, 0.64)) + box(
        "b", (0.7, 0.08, 0.4), (0.74, 0.1, 0.64)
    )
    bars += box("low", (0.4, 0.1, 0.4), (0.74, 0.12, 0.44), "velocity = [0.5, 0, 0]")
    axis = 'axis = "y"'
    joints = "".join(
        joint("hinge", between, (x, 0.1, z), axis)
        for between, x, z in [
            (["a"], 0.42, 0.62), (["b"], 0.72, 0.62), (["a", "low"], 0.42, 0.42),
            (["b", "low"], 0.72, 0.42),
        ]
    )  # fmt: skip
    simulation, bodies, system = jointed(tmp_path, bars, joints)
    for _ in range(300):
        simulation.advance(1e-3)
        assert distances(system) < 1e-3 * DX
        assert np.abs(bodies.v[2, 3:]).max() < 1e-4, "the lower bar turns"
    assert np.abs(bodies.v[0, 4]) > 0.1
    assert bodies.v[0, 4] == pytest.approx(bodies.v[1, 4], abs=1e-6)


def test_contact_and_joints_hold_together(tmp_path):
    """A beam on a hinge rests with its other end on a loose block."""
    beam = box("beam", (0.4, 0.06, 0.06), (0.9, 0.14, 0.1))
    block = box("block", (0.8, 0.06, 0.0), (0.86, 0.14, 0.06))
    simulation, bodies, joints = jointed(
        tmp_path, beam + block, joint("hinge", ["beam"], (0.42, 0.1, 0.08), 'axis = "y"')
    )
    start = bodies.x.copy()
    for _ in range(500):
        simulation.advance(1e-3)
    assert np.abs(bodies.x - start).max() < 1e-2 * DX
    assert np.abs(bodies.v).max() < 1e-5 and distances(joints) < 1e-5 * DX


def test_joined_bodies_do_not_collide(tmp_path):
    """Two boxes overlap at their hinge."""
    two = box("a", (0.4, 0.08, 0.5), (0.6, 0.12, 0.54)) + box(
        "b", (0.56, 0.08, 0.5), (0.8, 0.12, 0.54)
    )
    simulation, bodies, _ = jointed(
        tmp_path, two, joint("hinge", ["a", "b"], (0.58, 0.1, 0.52), 'axis = "y"'), 0
    )
    simulation.advance(1e-3)
    assert np.abs(bodies.v).max() == 0.0
    simulation, bodies, _ = jointed(tmp_path, two, "", 0)
    simulation.advance(1e-3)
    assert np.abs(bodies.v).max() > 1e-3, "they do not overlap"


def test_a_moving_collider_carries_what_is_fixed_to_it(tmp_path):
    plate = (
        '[[object]]\nname = "plate"\nrole = "scenery"\ncollider = true\n'
        "shape = { box = [[0.3, 0.06, 0.5], [0.5, 0.14, 0.56]] }\n"
        'motion = { velocity = [0.3, 0, 0], angular_velocity = 2, axis = "y", end_time = 0.4 }\n'
    )
    rod = box("rod", (0.5, 0.09, 0.5), (0.74, 0.11, 0.54))
    simulation, bodies, joints = jointed(
        tmp_path, plate + rod, joint("fixed", ["plate", "rod"], (0.5, 0.1, 0.52))
    )
    start = bodies.x[0].copy()
    for _ in range(300):
        simulation.advance(1e-3)
    pose = simulation.poses()[0]
    assert np.abs(pose[:3, :3] @ start + pose[:3, 3] - bodies.x[0]).max() < 1e-3 * DX
    assert np.abs(bodies.rotations()[0] - pose[:3, :3]).max() < 1e-4
    assert distances(joints) < 1e-3 * DX


def test_a_probe_of_a_body(tmp_path):
    """The mean force and torque on a rod are those of its hinge and its motor, without its weight;
    its pose and velocity are those of a turn about the hinge."""
    motor = 'axis = "y"\nname = "axle"\nmotor = { speed = -2, torque = 0.6 }'
    probes = "".join(
        f'[[probe]]\nname = "{name}"\nsampling_rate = 1e4\n{what}\n'
        for name, what in (("axle", 'joint = "axle"'), ("rod", 'object = "rod"'))
    )
    text = SCENE.format(
        gravity=-G, heavy=1, bodies=ROD, joints=joint("hinge", ["rod"], PIVOT, motor) + probes
    )
    simulation, _ = begin(tmp_path, text)
    probes = Probes(scene(tmp_path, text), simulation, None, None)
    probes.first()
    for _ in range(50):
        simulation.advance(1e-3)
        probes.after_step(simulation.time - 1e-3)
    assert np.isnan(probes.rows["rod"][0]["force_z"])

    def columns(probe, name, axes="xyz"):
        return np.array([[row[f"{name}_{a}"] for a in axes] for row in probes.rows[probe][1:]])

    force, center = columns("rod", "force"), columns("rod", "center")
    assert np.abs(force - columns("axle", "force")).max() < 1e-9 * np.abs(force).max()
    spin = columns("rod", "angular_velocity")
    velocity = np.cross(spin, center - PIVOT)
    # the hinge holds its point at the start of a step to the velocity at its end
    assert np.abs(columns("rod", "velocity") - velocity).max() < 2e-3 * np.abs(velocity).max()
    torque = columns("axle", "torque") + np.cross(PIVOT - center, force)
    assert np.abs(columns("rod", "torque") - torque).max() < 5e-3 * np.abs(torque).max()
    angle = 2.0 * np.arctan2(columns("rod", "rotation", "y"), columns("rod", "rotation", "w"))
    joint_angle = [row["angle"] for row in probes.rows["axle"][1:]]
    assert angle[:, 0] == pytest.approx(joint_angle, abs=1e-12)


def test_a_probe_of_a_joint(tmp_path):
    """A motor turns a rod against its weight; its hinge bears what the rod does not fall."""
    more = 'axis = "y"\nname = "axle"\nmotor = { speed = -2, torque = 0.6 }'
    probe = '[[probe]]\nname = "p"\nsampling_rate = 1e4\njoint = "axle"\n'
    text = SCENE.format(
        gravity=-G, heavy=1, bodies=ROD, joints=joint("hinge", ["rod"], PIVOT, more) + probe
    )
    simulation, _ = begin(tmp_path, text)
    bodies, probes = (
        simulation.features["rigid_bodies"].bodies,
        Probes(scene(tmp_path, text), simulation, None, None),
    )
    probes.first()
    momentum = bodies.momentum[0].copy()
    for _ in range(100):
        simulation.advance(1e-3)
        probes.after_step(simulation.time - 1e-3)
    rows = probes.rows["p"]
    assert rows[0]["angle"] == 0.0 and np.isnan(rows[0]["force_x"]) and np.isnan(rows[-1]["length"])
    impulse = 1e-3 * np.array([[row[f"force_{a}"] for a in "xyz"] for row in rows[1:]]).sum(0)
    weight = np.array([0, 0, -G * 0.1 * bodies.mass[0]])
    assert np.abs(momentum + impulse + weight - bodies.momentum[0]).max() < 1e-12
    turned = np.arctan2(bodies.x[0, 2] - PIVOT[2], bodies.x[0, 0] - PIVOT[0])
    assert rows[-1]["angle"] == pytest.approx(-turned, abs=1e-12)
    assert all(row["torque_y"] == pytest.approx(-0.6, rel=1e-9) for row in rows[1:10])
    assert max(abs(row["torque_x"]) for row in rows[1:]) < 1e-9
    energy = 0.5 * bodies.v[0, 3:] @ bodies.spin[0] + 0.5 * bodies.momentum[0] @ bodies.v[0, :3]
    energy += bodies.mass[0] * G * (bodies.x[0, 2] - PIVOT[2])
    work = 1e-3 * sum(row["motor_power"] for row in rows[1:])
    held("motor of a hinge that lifts a rod: work over energy gained", float(work / energy), 1.0,
         0.02, source="conservation of energy", note="dt 1 ms")  # fmt: skip
