"""Two fluids that mix, held to theory.

- Alike: two coupled fluids of the same numbers, no diffusion, slip time 0, are one fluid in one
  velocity field: the same positions to 1e-12 cell.
- Diffusion in a closed box: a = erfc(x / sqrt(4 D t)) / 2 (Crank, The Mathematics of Diffusion, 2nd
  ed. 1975, eq. 2.14) from a sharp start; root mean square of the shares of volume at the nodes
  less theory: .05 at 40 cells, .02 at 80. |J - 1| < 1e-3 afterwards.
- Separation: where gravity pulls apart what is mixed, the slip settles at v1 - v2 = -t_s grad p
  (1 / rho1 - 1 / rho2), grad p = rho_m g; 1 %, and 1 % between a time step and its half.
- Rayleigh-Taylor: an interface's ripple grows as sinh(sigma t), sigma^2 = A g k tanh(k H), A the
  Atwood number, H the depth of either fluid (Chandrasekhar, Hydrodynamic and Hydromagnetic
  Stability, 1961, section 92); 25 %. Two velocity fields, mixing without diffusion.
- Three fluids at one node: momentum to 1e-12 sum m |v|; renumbered, positions to 1e-12 cell.
"""

from math import erfc

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id, mass_speed, totals
from tests.support.validation_record import held

# --- the same numbers: one fluid ---

SAME = """
accuracy = { pressure = "explicit", precision = "double", volume_correction = "none" }
time = { end = 1, cfl = 0.4 }
[domain]
size = [0.32, 0.16, 0.16]
cell = 0.02
gravity = [0, 0, -9.8]
[material.water]
kind = "fluid"
tait_coefficient = 1e4
viscosity = 0.1
[material.milk]
kind = "fluid"
tait_coefficient = 1e4
viscosity = 0.1
[[object]]
name = "left"
material = "water"
shape = { box = [[0, 0, 0], [0.11, 0.16, 0.12]] }
velocity_mode = { amplitude = [0.9, 0.3, 0], wave_vector = [10, 5, 0] }
[[object]]
name = "right"
material = "milk"
shape = { box = [[0.11, 0, 0], [0.32, 0.16, 0.12]] }
velocity_mode = { amplitude = [0.9, 0.3, 0], wave_vector = [10, 5, 0] }
"""
MIXES = '[[coupling]]\nbetween = ["water", "milk"]\nkind = "mixing"\n'


def test_two_fluids_alike_are_one(tmp_path):
    found = []
    for text in (SAME, SAME + MIXES):
        simulation, _ = begin(tmp_path, text)
        for _ in range(200):
            simulation.advance(4e-4)
        assert simulation.sorts > 1
        found.append(by_id(simulation, "x", "v"))
    assert len(simulation.plan.phases) == 2
    (x, v), (other_x, other_v) = found
    assert np.abs(v).max() > 0.3
    held(
        "fluids alike are one: positions [cells]",
        float(np.abs(x - other_x).max() / 0.02), 0.0, 1e-12, kind="absolute",
        source="identity", note="200 steps of a sloshing pool",
    )  # fmt: skip
    assert np.abs(v - other_v).max() <= 1e-12 * np.abs(v).max()


# --- diffusion ---

LENGTH, WIDTH = 0.8, 0.1  # [m] of the box, of the layer sqrt(4 D t) at the end
DIFFUSION = 1e-3  # [m2/s]
BOX = f"""
[domain]
size = [{LENGTH}, SIDE, SIDE]
cell = CELL
gravity = [0, 0, 0]
[time]
end = 1
[accuracy]
pressure = "explicit"
precision = "PRECISION"
[material.water]
kind = "fluid"
tait_coefficient = 100
[material.milk]
kind = "fluid"
tait_coefficient = 100
[[coupling]]
between = ["water", "milk"]
kind = "mixing"
diffusivity = {DIFFUSION}
"""


def layer(x, width):
    """Share of the fluid on the left at x (n,) [m] when the layer has this width."""
    return np.array([erfc((c - LENGTH / 2) / width) / 2 for c in x])


def shares_at_nodes(x, volume, cells):
    """Shares of volume of the first fluid at the inner nodes, weighted as the solver does."""
    dx, sums = LENGTH / cells, []
    for at, part in zip(x, volume, strict=True):
        base = np.floor(at / dx - 0.5).astype(int)
        f, into = at / dx - base, np.zeros(cells + 3)
        for i, w in enumerate((0.5 * (1.5 - f) ** 2, 0.75 - (f - 1) ** 2, 0.5 * (f - 0.5) ** 2)):
            np.add.at(into, base + i + 1, w * part)
        sums.append(into[2 : cells + 1])
    return sums[0] / (sums[0] + sums[1])


def spread(folder, cells, per_cell, start=0.0, kind="mixing", precision="single"):
    """(nodes [m], shares, theory, |J - 1|) when a layer of width `start` has spread to WIDTH."""
    dx, half = LENGTH / cells, LENGTH / 2
    text = BOX.replace("SIDE", repr(4 * dx)).replace("CELL", repr(dx))
    text = text.replace('"mixing"', f'"{kind}"').replace("PRECISION", precision)
    edges = {"water": (0.0, half), "milk": (half, LENGTH)}
    for name, (low, high) in edges.items():
        said = ""
        if start:
            low, high = 0.0, LENGTH
            at = np.linspace(0, LENGTH, 2 * cells + 1)
            share = layer(at, start) if name == "water" else 1.0 - layer(at, start)
            at, share = at.round(9).tolist(), share.round(9).tolist()
            points = f"positions = {at}, values = {share}"
            said = f'volume_fraction_profile = {{ axis = "x", {points} }}\n'
        box = f"[[{low}, 0, 0], [{high}, {4 * dx!r}, {4 * dx!r}]]"
        text += f'[[object]]\nname = "a {name}"\nmaterial = "{name}"\nshape = {{ box = {box} }}\n'
        text += f"particles_per_cell = {per_cell}\n{said}"
    simulation, made = begin(folder, text)
    advance(simulation, (WIDTH**2 - start**2) / (4 * DIFFUSION))
    (x,) = by_id(simulation, "x")
    theta = np.concatenate([group.f[13, group.index()] for group in simulation.groups])
    whose = [made.object == k for k in (0, 1)]
    found = shares_at_nodes([x[w, 0] for w in whose], [made.vol0[w] for w in whose], cells)
    nodes = np.arange(1, cells) * dx
    return nodes, found, layer(nodes, WIDTH), np.abs(np.expm1(theta.astype(float)))


def rms(a):
    return float(np.sqrt((a**2).mean()))


def hold_layer(case, spread_out, tolerance, note, **more):
    nodes, found, theory, _ = spread_out
    held(
        case, rms(found - theory), 0.0, tolerance, kind="absolute", note=note,
        source="erfc(x / sqrt(4 D t)) / 2, Crank 1975",
        curves={"solver": (nodes, found), "theory": (nodes, theory)},
        axes=("x [m]", "share of volume"), **more,
    )  # fmt: skip


@pytest.fixture(scope="module")
def sharp(tmp_path_factory):
    return spread(tmp_path_factory.mktemp("sharp"), 40, 8)


def test_diffusion_from_a_sharp_start(sharp):
    hold_layer("diffusion, 40 cells", sharp, 0.05, "sharp start, 8 particles per cell")


def test_diffusion_on_a_finer_grid(tmp_path):
    found = spread(tmp_path, 80, 27)
    hold_layer("diffusion, 80 cells", found, 0.02, "sharp start, 27 particles per cell")


def test_diffusion_of_a_layer_keeps_the_volume(tmp_path):
    """A layer that begins two cells wide, with particles of both fluids everywhere."""
    found = spread(tmp_path, 40, 8, start=0.04)
    note = "from a layer of 2 cells, 8 particles per cell of each fluid"
    hold_layer("diffusion of a layer, 40 cells", found, 0.02, note)
    held(
        "diffusion at constant pressure: |J - 1|", float(found[3].max()), 0.0, 1e-3,
        kind="absolute", source="equal densities: no flux of volume", note=note,
    )  # fmt: skip


def test_a_sharp_start_keeps_the_volume(sharp):
    """Whole layers of particles jump at up to half a cell per step at first. If they carried their
    drifts' momenta along it would be 7e-2."""
    held(
        "diffusion from a sharp start: |J - 1|", float(sharp[3].max()), 0.0, 1e-3,
        kind="absolute", source="equal densities: no flux of volume", note="8 particles per cell",
    )  # fmt: skip


def test_the_printed_sign_unmixes(tmp_path):
    found = spread(tmp_path, 40, 8, start=0.06, kind="mixing-versagauss")
    note = "plus as VersaGauss prints it, from a layer of 3 cells: it gets steeper"
    hold_layer("diffusion, sign as printed", found, 0.05, note, expected=False)
    nodes, shares, _, _ = found
    wide = (layer(nodes, 0.06) * (1 - layer(nodes, 0.06))).sum()
    assert (shares * (1 - shares)).sum() < 0.8 * wide


# --- separation ---

HEAVY, LIGHT, GRAVITY, RAMP, HIGH = 1000.0, 500.0, 1.0, 0.2, 0.4
MIXED = f"""
[domain]
size = [0.08, 0.08, {HIGH}]
cell = 0.02
gravity = [0, 0, {-GRAVITY}]
gravity_ramp_time = {RAMP}
[time]
end = 1
[accuracy]
pressure = "explicit"
precision = "single"
[material.heavy]
kind = "fluid"
density = {HEAVY}
tait_coefficient = 1e4
[material.light]
kind = "fluid"
density = {LIGHT}
tait_coefficient = 1e4
[[object]]
name = "one"
material = "heavy"
volume_fraction = 0.5
shape = {{ box = [[0, 0, 0], [0.08, 0.08, {HIGH}]] }}
[[object]]
name = "other"
material = "light"
volume_fraction = 0.5
shape = {{ box = [[0, 0, 0], [0.08, 0.08, {HIGH}]] }}
[[coupling]]
between = ["heavy", "light"]
kind = "KIND"
slip_relaxation_time = SLIP
"""


def slip(folder, slip_relaxation_time, dt, kind="mixing"):
    """Mean slip heavy - light [m/s] along z in the middle of the box, over a ring of the pressure.
    On the floor and the roof there is none, and some cells feel that.
    """
    text = MIXED.replace("SLIP", repr(slip_relaxation_time)).replace("KIND", kind)
    simulation, made = begin(folder, text)
    seen = []
    while simulation.time < 2 * RAMP:
        simulation.advance(dt)
        if simulation.time > RAMP and simulation.step % 4 == 0:
            x, v = by_id(simulation, "x", "v")
            middle = np.abs(x[:, 2] - HIGH / 2) < 0.08
            one, other = (middle & (made.object == k) for k in (0, 1))
            seen.append(v[one, 2].mean(dtype=float) - v[other, 2].mean(dtype=float))
    return float(np.mean(seen))


def test_terminal_slip(tmp_path):
    """At 5 and 10 ms; the mixture's density is that of two halves."""
    dt = 6e-4
    source = "-t_s grad p (1/rho1 - 1/rho2)"
    found = {}
    for slip_time in (5e-3, 10e-3):
        want = slip_time * GRAVITY * (HEAVY + LIGHT) / 2 * (1 / HEAVY - 1 / LIGHT)
        found[slip_time] = slip(tmp_path, slip_time, dt)
        case = f"slip of two fluids under gravity, slip time {slip_time * 1e3:.0f} ms"
        held(case, found[slip_time], want, 0.01, unit="m/s", source=source, note="20 cells high")
    halved = slip(tmp_path, 5e-3, dt / 2)
    case = "slip of two fluids with half the time step"
    held(case, halved / found[5e-3], 1.0, 0.01, source="does not depend on the step")


def test_the_printed_slip_follows_the_time_step(tmp_path):
    whole, half = (slip(tmp_path, 5e-3, dt, "mixing-versagauss") for dt in (6e-4, 3e-4))
    case = "slip as printed with half the time step"
    held(case, half / whole, 1.0, 0.01, expected=False, note="it halves with the step")
    assert half / whole == pytest.approx(0.5, abs=0.01)


# --- Rayleigh-Taylor ---

ACROSS, DEPTH, PULL, SPEED = 0.4, 0.3, 10.0, 0.04
TWO_LAYERS = f"""
[domain]
size = [{ACROSS}, THICK, {2 * DEPTH}]
cell = CELL
gravity = [0, 0, {-PULL}]
[time]
end = 1
[accuracy]
pressure = "explicit"
precision = "single"
[material.heavy]
kind = "fluid"
density = 1500
tait_coefficient = 1e5
[material.light]
kind = "fluid"
density = 500
tait_coefficient = 1e5
[[object]]
name = "above"
material = "heavy"
shape = {{ box = [[0, 0, {DEPTH}], [{ACROSS}, THICK, {2 * DEPTH}]] }}
MODE
[[object]]
name = "below"
material = "light"
shape = {{ box = [[0, 0, 0], [{ACROSS}, THICK, {DEPTH}]] }}
MODE
[[coupling]]
between = ["heavy", "light"]
kind = "mixing"
"""


@pytest.mark.parametrize("cells", [20, pytest.param(40, marks=pytest.mark.slow)])
def test_rayleigh_taylor(tmp_path, cells):
    """The ripple's height from the heavy fluid's volume: sum V cos(k x) = -height area / 2."""
    k, dx = np.pi / ACROSS, ACROSS / cells
    text = TWO_LAYERS.replace("THICK", repr(4 * dx)).replace("CELL", repr(dx))
    mode = f"amplitude = [0, 0, {SPEED}], wave_vector = [{k!r}, 0, 0], phase_angle = {np.pi / 2!r}"
    simulation, made = begin(tmp_path, text.replace("MODE", f"velocity_mode = {{ {mode} }}"))
    heavy, times, heights = made.object == 0, [], []
    for t in np.linspace(0.02, 0.36, 18):
        advance(simulation, t)
        (x,) = by_id(simulation, "x")
        ripple = -(made.vol0[heavy] * np.cos(k * x[heavy, 0])).sum() * 2 / (ACROSS * 4 * dx)
        times.append(t)
        heights.append(ripple)
    assert len(simulation.plan.phases) == 2
    times, heights = np.array(times), np.array(heights)
    # sinh(s t) with the height as a free factor: least squares over s
    rates = np.linspace(1.0, 15.0, 1401)
    shape = np.sinh(np.outer(rates, times))
    factor = (shape @ heights) / (shape**2).sum(1)
    best = ((factor[:, None] * shape - heights) ** 2).sum(1).argmin()
    found = float(rates[best])
    want = float(np.sqrt(0.5 * PULL * k * np.tanh(k * DEPTH)))
    print(f"heights [mm] {(1e3 * heights).round(2)}")
    held(
        f"Rayleigh-Taylor: rate of growth, {cells} cells", found, want, 0.25, unit="1/s",
        source="sqrt(A g k tanh(k H)), Chandrasekhar 1961",
        note=f"{cells} cells to half a wave, densities 3 : 1, mixing without diffusion",
        curves={"solver": (times, heights), "sinh": (times, factor[best] * shape[best])},
        axes=("time [s]", "height [m]"),
    )  # fmt: skip


# --- three fluids ---

THREE = """
accuracy.pressure = "explicit"
accuracy.precision = "double"
[domain]
size = [0.32, 0.32, 0.32]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 1
"""
BALLS = {"A": ((0.13, 0.16, 0.15), (1, 0.1, 0)), "B": ((0.2, 0.16, 0.15), (-1, 0, 0.2)),
         "C": ((0.165, 0.16, 0.21), (0, 0.1, -0.8))}  # fmt: skip
DENSITY = {"A": 1000, "B": 700, "C": 1500}


def three(folder, names):
    """The simulation after 100 steps; names: of the three materials, whose order numbers them."""
    text = THREE
    for ball, (centre, velocity) in BALLS.items():
        text += f'[material.{names[ball]}]\nkind = "fluid"\ndensity = {DENSITY[ball]}\n'
        text += "tait_coefficient = 5000\n"
        text += f'[[object]]\nname = "ball {ball}"\nmaterial = "{names[ball]}"\n'
        text += f"velocity = {list(velocity)}\n"
        text += f"shape = {{ sphere = {{ center = {list(centre)}, radius = 0.05 }} }}\n"
    for a, b in ("AB", "BC"):
        text += f'[[coupling]]\nbetween = ["{names[a]}", "{names[b]}"]\nkind = "mixing"\n'
        text += "diffusivity = 1e-4\nslip_relaxation_time = 2e-3\n"
    simulation, made = begin(folder, text)
    before = totals(simulation)["momentum"]
    met = 0
    for _ in range(100):
        simulation.advance(4e-4)
        met = max(met, int((np.diff(simulation.exchange.tables.first) == 3).sum()))
    return simulation, made, totals(simulation)["momentum"] - before, met


def test_three_fluids(tmp_path):
    simulation, made, change, met = three(tmp_path, {"A": "a", "B": "b", "C": "c"})
    assert met > 4, "they hardly met"
    held(
        "three fluids that mix: momentum", np.abs(change).max() / mass_speed(simulation, made),
        0.0, 1e-12, kind="absolute", source="conservation", note="of sum m |v|, 100 steps",
    )  # fmt: skip
    other, _, _, _ = three(tmp_path, {"A": "z", "B": "y", "C": "x"})
    order = [[phase.objects for phase in s.plan.phases] for s in (simulation, other)]
    assert order[0] == order[1][::-1] != order[1]
    (x,), (other_x,) = (by_id(s, "x") for s in (simulation, other))
    held(
        "three fluids renumbered: positions [cells]", np.abs(x - other_x).max() / 0.02, 0.0, 1e-12,
        kind="absolute", source="identity", note="100 steps",
    )  # fmt: skip
