"""What a scene does not ask for is not there: no array, no kernel, no bit of a difference.

Every array that can be reached from a simulation is listed by name
(tests/support/reachable_arrays.py), and every specialisation of a kernel that its steps have
called. Expected of one fluid in a box: particles, segments, one layer of nodes, and tables of a
number per segment or block. Each feature then adds what it needs, and nothing else.
"""

import re

import numpy as np
import pytest

from tests.support import reachable_arrays
from tests.support.simulate import begin, by_id
from vgmpi.kernels import particle_records

PLAIN = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.32, 0.32, 0.32]
cell = 0.02
[time]
end = 1
[material.water]
kind = "fluid"
tait_coefficient = 5e4
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.16, 0.16, 0.16]] }
"""
# S segments, B blocks of nodes, R rows of them with room to grow, P places of particles of C
# numbers, Q numbers of a scratch patch, T times of frames
ARRAYS = """
groups.*.xi 3 P
groups.*.f C P
groups.*.ids P
groups.*.spare P
groups.*.block S 3
groups.*.code S
groups.*.count S
groups.*.start S
engine.layers.momentum.sums R 2 256
engine.layers.momentum.nodes R 256
engine.layers.momentum.has_terms B
engine.layers.momentum.phase B
engine.parts.*.segments.accumulator_rows S 27
engine.parts.*.segments.table S 27
engine.parts.*.segments.limit S 3 2
engine.parts.*.segments.mirror S 3 2
engine.parts.*.segments.split S
engine.parts.*.contributions.*.chosen S
engine.parts.*.timeless.*.chosen S
engine.parts.*.partition.all.* S
engine.parts.*.partition.inner.* S
engine.block_shares.all.* B
engine.block_shares.inner.* B
engine.blocks.copy_offsets B+1
engine.layers.offsets.has_terms B
engine.scratch.*.real Q
engine.scratch.*.integers 150
engine.scratch.*.peak 16
exchange.tables.code S
exchange.tables.group S
exchange.tables.block S 3
exchange.tables.border S
exchange.tables.table S 27
exchange.tables.contributes.momentum S
exchange.tables.contributes.offsets S
exchange.tables.first B+1
exchange.tables.phase B
exchange.tables.coordinates B 3
exchange.tables.may_touch B
exchange.tables.receives_remote B
exchange.tables.solid B
exchange.tables.has_terms.momentum B
exchange.tables.has_terms.offsets B
exchange.census.code S
exchange.census.group S
exchange.census.key S
exchange.census.owner S
exchange.census.particles S
plan.times T
"""
# at most so many numbers, however large the scene: of phases and walls, and scratch of a node
FEW = 70
HANDFUL = (
    "exchange.census.load", "engine.phase_sets", "engine.overflow", "features.shifting",
    "engine.layers.momentum.bias",
    "engine.layers.momentum.current_bounds", "engine.layers.offsets.bias",
    "engine.layers.offsets.current_bounds",
    "engine.phases", "engine.reports", "engine.workspaces", "engine.step", "engine.walls",
    "gravity", "exchange.needs", "reduction_buffer",
)  # fmt: skip
KERNELS = {
    "particles_to_grid(Momentum, FluidLaw, Segments, Particles, Scratch, None)",
    "particles_to_grid(MomentumWithoutStress, None, Segments, Particles, Scratch, None)",
    "grid_to_particles(FluidLaw, Segments, Particles, VelocityOnly, Scratch, GroupConstants,"
    " StepConstants, None)",
    "apply_transfer_correction(Segments, Particles, Scratch, ShiftConstants, None)",
    "apply_transfer_correction(Segments, Particles, Scratch, None, None)",
    "momentum_to_velocity_only(NodeBlocks, Sums, Phases, NodeFill, None, Step)",
    "momentum_to_velocity_only(NodeBlocks, Sums, Phases, None, None, Step)",
    "update(NodeBlocks, CommonFields(Sums, Sums), None, None, None, Walls, Phases,"
    " RigidBoundaries(PrescribedSteps), ContactWorkspace(None), Step)",
}
BLOCK = """
[[object]]
name = "block"
material = "stuff"
shape = { box = [[LOW, 0, 0], [HIGH, 0.16, 0.16]] }
"""
PINNED = BLOCK.replace("LOW", "0.16").replace("HIGH", "0.24") + (
    "pinned = { box = [[0, 0, 0], [0.2, 0.3, 0.3]] }\n"
)
BESIDE = BLOCK.replace("LOW", "0.16").replace("HIGH", "0.24")
WITHIN = BLOCK.replace("LOW", "0").replace("HIGH", "0.16")
POST = """
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0.18, 0.04, 0.04], [0.24, 0.12, 0.12]] }
"""
RUBBER = '[material.stuff]\nkind = "elastic"\nyoungs_modulus = 1e5\n'
MILK = '[material.stuff]\nkind = "fluid"\ntait_coefficient = 5e4\n'
GRAINS = '[material.stuff]\nkind = "sand"\n'
COUPLED = '[[coupling]]\nbetween = ["water", "stuff"]\n'
# what is defined and nothing is made of
UNUSED = (
    GRAINS
    + """
[material.toy]
kind = "elastic"
youngs_modulus = 1e5
[material.milk]
kind = "fluid"
[[coupling]]
between = ["water", "stuff"]
kind = "drag"
hydraulic_conductivity = 1e-3
[[coupling]]
between = ["water", "milk"]
kind = "mixing"
diffusivity = 1e-4
[[coupling]]
between = ["toy", "water"]
kind = "contact"
friction = 0.3
"""
)
SHARED = {
    "engine.layers.impulses", "engine.gathered_nodes.flux", "engine.stage_scratch",
    "engine.layers.stage", "engine.shared_stress", "needs.separates_stress", "plan.features",
    "tables.has_terms.impulses", "tables.contributes.impulses",
}  # fmt: skip


# records of an engine, which are left out of names; it holds the tables of the exchange, too
RECORDS = {
    "engine.layers.by_name": "engine.layers",
    "engine.layers.gathered_nodes": "engine.gathered_nodes",
    "engine.memory": "engine", "engine.plan_tables": "engine", "engine.tables": "exchange.tables",
}  # fmt: skip


def simulated(folder, text):
    """A simulation after some steps, and the calls of its kernels."""
    with reachable_arrays.Calls() as calls:
        simulation, _ = begin(folder, text)
        for _ in range(2 * simulation.plan.correction_interval + 2):
            simulation.advance(simulation.bound())
    return simulation, calls


def shapes(simulation):
    """By name, a number in which is a star: the shape of each array that holds anything."""
    found = {}
    for name, array in reachable_arrays.arrays(simulation).items():
        for record, owner in RECORDS.items():
            name = name.replace(f"{record}.", f"{owner}.")
        if array.size:
            found[re.sub(r"\.\d+(?=\.|$)", ".*", name)] = array.shape
    return found


def parts(names):
    """What arrays belong to, in a word or three."""
    found = set()
    for name in names:
        words = [word for word in name.split(".") if word not in ("*", "exchange")]
        wide = words[0] in ("engine", "tables", "needs", "plan", "features")
        deep = wide and words[1] in (
            "layers",
            "gathered_nodes",
            "workspaces",
            "parts",
            "has_terms",
            "contributes",
        )
        found.add(".".join(words[: 1 + wide + deep]))
    return found


def kinds(told):
    """The kernels and types that specialisations are made of."""
    return set(re.findall(r"\w+", " ".join(told)))


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("plain"), PLAIN)


def test_every_array_of_one_fluid_in_a_box(plain):
    simulation, _ = plain
    group, tables = simulation.groups[0], simulation.exchange.tables
    sizes = {
        "S": len(group.start),
        "B": len(tables.coordinates),
        "R": len(tables.coordinates) + len(tables.coordinates) // 4,
        "P": len(group.ids),
        "C": 3 + 9 + 1 + 1,  # v, C, vol0, theta
        "Q": len(simulation.engine.memory.scratch[0].real),
        "T": len(simulation.plan.times),
    }
    sizes["B+1"] = sizes["B"] + 1
    lines = [line.split() for line in ARRAYS.split("\n") if line]
    expected = {
        name: tuple(sizes.get(word) or int(word) for word in words) for name, *words in lines
    }
    found = shapes(simulation)
    small = {name for name in found if name.startswith(HANDFUL) and name not in expected}
    assert {name: found[name] for name in found if name not in small} == expected
    assert all(np.prod(found[name]) <= FEW for name in small)
    assert not simulation.exchange.halo.sends and not simulation.exchange.halo.receives


def test_every_kernel_of_one_fluid_in_a_box(plain):
    assert plain[1].compiled == KERNELS


def test_without_volume_correction_nothing_of_it_exists(tmp_path, plain):
    text = PLAIN.replace("precision", 'volume_correction = "none"\nprecision')
    simulation, calls = simulated(tmp_path, text)
    gone = set(shapes(plain[0])) - set(shapes(simulation))
    assert parts(gone) == {"features.shifting"}
    assert not set(shapes(simulation)) - set(shapes(plain[0]))
    assert kinds(KERNELS) - kinds(calls.compiled) == {"NodeFill", "ShiftConstants"}
    patch = len(plain[0].engine.memory.scratch[0].real) - len(
        simulation.engine.memory.scratch[0].real
    )
    assert patch == particle_records.PADDED_PATCH


def test_what_is_defined_and_not_used_changes_nothing(tmp_path, plain):
    """The same arrays, kernels and bits."""
    simulation, calls = simulated(tmp_path, PLAIN + UNUSED)
    assert shapes(simulation) == shapes(plain[0])
    assert calls.compiled == plain[1].compiled
    for name in ("x", "v", "C", "J"):
        for one, other in zip(by_id(simulation, name), by_id(plain[0], name), strict=True):
            assert np.array_equal(one, other)


def test_what_is_not_used_bounds_no_step(tmp_path):
    """A fixed one is not refused for fluids of which one is not there; they would bear 7 us."""
    fixed = PLAIN.replace("end = 1", "end = 1\ndt = 1e-4")
    unused = UNUSED.replace("diffusivity = 1e-4", "diffusivity = 10")
    assert begin(tmp_path, fixed + unused)[0].plan.time_step.fixed == 1e-4


WITH_SAND = PLAIN.replace('"fluid"\ntait_coefficient = 5e4', '"sand"')
IN_PORES = PLAIN.replace('name = "pool"', 'name = "pool"\nvolume_fraction = 0.4') + GRAINS + WITHIN
RED = BESIDE + 'color = "#ff0000"\n'
TRAVELS = '[appearance]\ncolor_transfer = "step"\n'
TAP = """
[[inlet]]
name = "tap"
material = "water"
disc = { center = [0.16, 0.16, 0.26], radius = 0.03 }
direction = [0, 0, -1]
speed = 1
"""
DRAIN = """
[[outlet]]
name = "drain"
shape = { box = [[0.24, 0, 0], [0.32, 0.32, 0.32]] }
"""
MIXES = {
    "SeparatedStress", "MixtureStage", "MixtureTables", "MixtureWorkspace", "Impulses",
    "MixtureGather",
}  # fmt: skip
# name: scene, parts with arrays, and kinds in kernels that the plain one has not
FEATURES = {
    "sand": (WITH_SAND, set(), {"SandLaw"}),
    "a solid": (
        PLAIN + RUBBER + BESIDE, {"engine.layers.offsets"},
        {"ElasticLaw", "SurfaceDistance", "Offsets"},
    ),
    "a region": (
        PLAIN + '[[object.region]]\nmaterial = "stuff"\nbox = [[0, 0, 0], [1, 1, 0.08]]\n' + MILK,
        set(), set(),
    ),
    "colors": (
        PLAIN + TRAVELS + MILK + RED,
        {"engine.layers.color 0", "tables.has_terms.color 0", "tables.contributes.color 0",
         "needs.fields", "features.color_transfer"},
        {"ValuesByVolume", "gather_values", "average_over_phases"},
    ),
    "mixing": (PLAIN + MILK + BESIDE + COUPLED + 'kind = "mixing"\n', SHARED, MIXES),
    "drift": (
        PLAIN + MILK + BESIDE + COUPLED + 'kind = "mixing"\ndiffusivity = 1e-4\n',
        {*SHARED, "engine.gathered_nodes.drift", "engine.layers.offsets"},
        {*MIXES, "CurrentVolumeMoments"},
    ),
    "drag": (
        IN_PORES + COUPLED + 'kind = "drag"\nhydraulic_conductivity = 1e-3\n', SHARED,
        {*MIXES, "SandLaw"},
    ),
    "a solid to which it sticks": (
        PLAIN.replace("tait_coefficient", "viscosity = 1\ntait_coefficient", 1)
        + RUBBER + BESIDE + "slip_length = 0\n",
        {"engine.layers.offsets", "features.surface_slip", "needs.fields", "needs.in_contact", *(
            f"{owner}.velocity gradient {a}"
            for owner in ("engine.layers", "tables.has_terms", "tables.contributes") for a in "xyz"
        )},
        {"ElasticLaw", "SurfaceDistance", "Offsets", "VelocityGradient", "NodesOfPhases",
         "SolidSlipLaw", "AdhesionLaw", "apply_solid_slip"},
    ),
    "a collider": (PLAIN + POST, {"engine.layers.offsets", "collider_nodes"}, {"Offsets"}),
    "a moving collider": (
        PLAIN + POST + "motion = { velocity = [0.01, 0, 0] }\n",
        {"engine.layers.offsets", "collider_nodes"},
        {"Offsets"},
    ),
    "a pinned part": (
        PLAIN + RUBBER + PINNED,
        {"engine.layers.offsets", "features.pinned_parts", "needs.fields", *(
            f"{owner}.velocity gradient {a}"
            for owner in ("engine.layers", "tables.has_terms", "tables.contributes") for a in "xyz"
        )},
        {"ElasticLaw", "SurfaceDistance", "Offsets", "VelocityGradient", "SampledSdf",
         "PinnedTable", "PinnedNodes", "PinnedFields", "apply_pins"},
    ),
    "a thin wall": (
        PLAIN + POST.replace("[0.24,", "[0.2,") + "thin = true\n",
        {"engine.layers.offsets", "collider_nodes", "features.thin_walls"},
        {"Offsets", "SidedPhases"},
    ),
    "an implicit pressure": (
        PLAIN.replace('pressure = "explicit"', 'pressure = "implicit"'),
        {"features.implicit_pressure", "engine.gathered_nodes.displacement", "needs.fields", *(
            f"{owner}.particle pressure"
            for owner in ("engine.layers", "tables.has_terms", "tables.contributes")
        )},
        {"ParticlePressure", "LiquidRows", "MomentumWithoutPressure", "ImplicitPressureGather",
         "Lattice", "PressureFields", "LevelFields", "hold_at_walls", "set_nodes",
         "set_cells", "set_excess", "begin_sweeps", "respond", "sweep", "multiply",
         "find_remainder", "interpolate", "sum_products", "add_velocities",
         "store_node_pressure", "store_moves", "CoarseBlocks", "WetRows", "count_responses",
         "sum_responses", "set_responses", "set_diagonal", "restrict", "set_residual", "cycle"},
    ),
    "an implicit viscosity": (
        PLAIN.replace("[accuracy]", '[accuracy]\nviscosity = "implicit"')
        .replace('"fluid"', '"fluid"\nviscosity = 10'),
        {"features.implicit_viscosity"},
        {"ViscousFields", "PhaseNodes", "set_nodes", "set_cells", "sweep", "store_velocities"},
    ),
    "an inlet": (PLAIN + TAP, {"features.inlets_outlets", "plan.features"}, set()),
    "an outlet": (PLAIN + DRAIN, {"features.inlets_outlets"}, set()),
    "a probe": (
        PLAIN + '[[probe]]\nname = "deep"\nsampling_rate = 100\npressure = [0.1, 0.1, 0.1]\n',
        set(), set(),
    ),
    "a wall that is felt": (
        PLAIN + '[[probe]]\nname = "bottom"\nsampling_rate = 100\nwall = "bottom"\n',
        {"features.reactions", "engine.reactions", "engine.parts.ghosts"},
        {"ReactionSums", "GhostNodes"},
    ),
    "density correction": (
        PLAIN.replace("precision", 'volume_correction = "density"\nprecision'), set(),
        {"DensityCorrected"},
    ),
    "flip": (
        PLAIN.replace("precision", 'transfer = "flip"\nprecision'),
        {"engine.layers.impulses", "engine.gathered_nodes.change",
         "tables.has_terms.impulses", "tables.contributes.impulses"},
        {"SeparatedStress", "VelocityChange", "Impulses", "FlipGather"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FEATURES)
def test_a_feature_adds_what_it_needs(tmp_path, plain, name):
    text, adds, compiles = FEATURES[name]
    simulation, calls = simulated(tmp_path, text)
    assert parts(set(shapes(simulation)) - set(shapes(plain[0]))) == adds
    assert kinds(calls.compiled) - kinds(KERNELS) == compiles
