"""Bodies that are held and let go, or driven, held to what the same bodies do by themselves.

Theory: what is let go knows nothing of the time before: from then on it does what one does that
begins then (positions to 1e-12 m). A body that is driven is a wall to all others: a ball that falls
on a slab that is held jumps off with the speed with which it came, but for what rings in it, and
one that a slab runs into with a velocity u goes off with 2 u (elastic, a mass without bounds). What
a body that is driven gives, the others get: momentum to rounding, its work as their energy. Free
of all forces what was driven keeps its momentum and its spin when it is let go. Double precision.
"""

import numpy as np

from tests.support.simulate import advance, begin, by_id, conservation_rows, totals
from tests.support.validation_record import held

HEAD = """
[domain]
size = SIZE
cell = CELL
gravity = [0, 0, GRAVITY]
boundary = "separate"
[time]
end = 1
[accuracy]
precision = "double"
"""
SAND = """
[material.sand]
kind = "sand"
youngs_modulus = "0.5 MPa"
[[object]]
name = "castle"
material = "sand"
shape = { box = [[0.1, 0.1, 0], [0.2, 0.2, 0.14]] }
"""
BALL = """
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
density = 1000
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0.15, 0.15, HEIGHT], radius = 0.06 } }
particles_per_cell = 27
velocity = [0, 0, SPEED]
[[object]]
name = "slab"
material = "rubber"
shape = { box = [[0.05, 0.05, 0.02], [0.25, 0.25, 0.07]] }
"""


def head(size, cell, gravity):
    words = {"SIZE": size, "CELL": cell, "GRAVITY": gravity}
    text = HEAD
    for name, value in words.items():
        text = text.replace(name, str(value))
    return text


def test_what_is_let_go_does_what_one_does_that_begins_then(tmp_path):
    text = head("[0.3, 0.3, 0.2]", 0.02, -9.81) + SAND
    free, made = begin(tmp_path, text)
    later, _ = begin(tmp_path, text + 'release_time = "0.3 s"\n')
    apart, moved = 0.0, 0.0
    for time in (0.05, 0.1, 0.2):
        advance(free, time)
        advance(later, 0.3 + time)
        (x,), (y,) = by_id(free, "x"), by_id(later, "x")
        apart = max(apart, float(np.abs(x - y).max()))
        moved = float(np.abs(x - made.x).max())
    assert moved > 0.03 and later.step < free.step + 5
    note = f"{len(made.x)} particles, which have moved {moved:.2g} m"
    held("frozen castle, against one that begins then", apart, 0.0, 1e-12, kind="absolute",
         unit="m", note=note)  # fmt: skip


def ball(simulation, made):
    """Its mean velocity and its height [m/s, m] along z."""
    x, v = by_id(simulation, "x", "v")
    return v[made.object == 0, 2].mean(), x[made.object == 0, 2].mean()


def test_a_ball_jumps_off_a_slab_that_is_held(tmp_path):
    text = head("[0.3, 0.3, 0.3]", 0.01, 0) + BALL.replace("HEIGHT", "0.135")
    simulation, made = begin(tmp_path, text.replace("SPEED", "-0.5") + 'release_time = "1 s"\n')
    before = by_id(simulation, "x")[0]
    advance(simulation, 0.1)
    off = ball(simulation, made)[0] / 0.5
    after = by_id(simulation, "x")[0]
    assert np.array_equal(before[made.object == 1], after[made.object == 1])
    note = "6 cells in radius, 27 particles per cell; it rings afterwards"
    held("ball on a slab that is held: restitution", off, 1.0, 0.05, note=note)


def test_a_slab_that_is_driven_throws_a_ball(tmp_path):
    """At u it gets 2 u: seen from the slab it comes with u and goes with u."""
    text = head("[0.3, 0.3, 0.3]", 0.01, 0) + BALL.replace("HEIGHT", "0.135")
    drive = 'motion = { velocity = [0, 0, 0.3], end_time = "0.1 s" }\n'
    simulation, made = begin(tmp_path, text.replace("SPEED", "0") + drive)
    advance(simulation, 0.0999)
    x, v = by_id(simulation, "x", "v")
    slab = made.object == 1
    assert np.abs(x[slab] - made.x[slab] - [0, 0, 0.3 * 0.0999]).max() < 1e-12
    assert np.allclose(v[slab], [0, 0, 0.3], atol=1e-12)
    note = "as a ball of .3 m/s on a slab that is held"
    held("ball before a slab that is driven: speed over the slab's", v[~slab, 2].mean() / 0.3, 2.0,
         0.04, note=note)  # fmt: skip


def test_what_was_driven_keeps_its_motion(tmp_path):
    text = head("[0.3, 0.3, 0.3]", 0.01, 0).replace('"separate"', '"slip"')
    text += BALL[: BALL.index("velocity")].replace("HEIGHT", "0.15")
    keys = 'velocity = [0.2, 0, 0.1], angular_velocity = "40 rad/s", axis = [1, 2, 0]'
    spun = f'motion = {{ {keys}, end_time = "50 ms" }}'
    simulation, _ = begin(tmp_path, text + spun)
    advance(simulation, 0.05)
    let_go = totals(simulation)
    advance(simulation, 0.15)
    found = totals(simulation)
    scale = np.linalg.norm(let_go["momentum"])
    lost = np.abs(found["momentum"] - let_go["momentum"]).max() / scale
    held("let go: change of momentum", lost, 0.0, 1e-12, kind="absolute")
    spin = np.array(let_go["angular"])
    lost = np.linalg.norm(found["angular"] - spin) / np.linalg.norm(spin)
    held("let go: change of spin in a turn", lost, 0.0, 2e-3, kind="absolute",
         note="it was not strained by turning while it was driven, and is then")  # fmt: skip


SMOOTH = '[[coupling]]\nkind = "contact"\nbetween = ["rubber", "rubber"]\nfriction = 0\n'
PROBE = '[[probe]]\nname = "slab"\nsampling_rate = 100\ncollider = "slab"\n'


def _thrown(tmp_path, motion):
    """(momentum and energy that a slab's motion gave a ball, impulse and work that are told)."""
    text = head("[0.3, 0.3, 0.3]", 0.01, 0) + BALL.replace("HEIGHT", "0.135")
    motion = f'motion = {{ {motion}, end_time = "0.1 s" }}\n'
    simulation, _ = begin(tmp_path, text.replace("SPEED", "0") + motion + SMOOTH + PROBE)
    advance(simulation, 0.0999)
    impulse, work = (
        simulation.features["reactions"].totals[0, :3],
        simulation.features["reactions"].totals[0, 6],
    )
    return *_of_ball(simulation), impulse, work


def test_what_it_gives_the_others_get(tmp_path):
    turning = 'velocity = [0.1, 0, 0.3], angular_velocity = "2 rad/s", axis = [1, 1, 0]'
    momentum, _, impulse, _ = _thrown(tmp_path, turning)
    scale = np.linalg.norm(momentum)
    lost = np.abs(momentum - impulse).max() / scale
    assert scale > 0.2
    held("driven slab: impulse given less the ball's momentum", lost, 0.0, 1e-12, kind="absolute")


def test_its_work_is_the_energy_of_the_others(tmp_path):
    momentum, energy, _, work = _thrown(tmp_path, "velocity = [0, 0, 0.3]")
    note = "no friction; the ball rings, which counts"
    held("driven slab: energy of the ball, of the work", energy, work, 0.01, unit="J", note=note)


def _of_ball(simulation):
    """Momentum (3,) and energy of the ball."""
    row = next(row for row in conservation_rows(simulation) if row["phase"] == "ball")
    energy = row["kinetic_energy"] + row["elastic_energy"]
    return np.array([row[f"momentum_{a}"] for a in "xyz"]), energy
