"""A copy of this program in which features do not exist, to be run beside it: sand, colors that
travel with steps, phases that share space, volume that is kept, and motion that is prescribed.

The files of materials and couplings are left out. Of the other modules every function has another
body: it raises, but for those that every scene asks whether it has the feature, which answer no.
"""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

import vgmpi
from vgmpi.io.run_reader import RunReader
from vgmpi.tools.bench.benchmark_case import BenchError

HERE = Path(vgmpi.__file__).parent
LEFT_OUT = (
    "vgmpi.materials.drucker_prager",
    "vgmpi.materials.couplings.mixing",
    "vgmpi.materials.couplings.mixing_versagauss",
    "vgmpi.materials.couplings.drag",
    "vgmpi.materials.couplings.drag_versagauss",
)
KEPT = ""
# of each module: what its functions answer where they do not raise; those that are kept are
ANSWERS: dict[str, dict[str, str]] = {
    "vgmpi.planning.interaction_rules": {
        "interaction_rules": "return None",
        "with_slip_wave_factors": "return groups",
        "connected_sets": KEPT,
    },  # fmt: skip
    "vgmpi.planning.color_exchange": {"color_exchange": "return None", "color_sets": KEPT},
    "vgmpi.planning.prescribed_bodies": {
        "prescribed_phases": "return {}",
        "prescribed_body_plans": "return (), groups, group_of",
    },
    "vgmpi.scene.regions": {
        "validate_regions": "return []",
        "validate_region_kinds": "return []",
    },
    "vgmpi.preprocess.body_regions": {
        "sort_by_region": "return piece",
        "validate_region_particles": "return []",
        "region_entries": "return []",
    },
    "vgmpi.planning.region_groups": {
        "region_plans": "return ()",
        "group_counts": "return [*zip(plan.count, plan.group_of)]",
        "groups_of_particles": "return np.array(plan.group_of)[owner]",
    },
    "vgmpi.kernels.grid.mixture_coupling": {},
    "vgmpi.kernels.nodal_fields.carried_values": {},
    "vgmpi.kernels.transfer.liquid_volume": {
        "clamp_to_unit": KEPT,
        "_gather_cell_divergence": KEPT,
        "_replace_trace": KEPT,
        "cell_pressure_kind": KEPT,
        "_cell_pressure": KEPT,
        "_add_by_cells": KEPT,
        "reduce_spray_divergence": KEPT,
    },
    "vgmpi.parallel.cell_exchange": {},
    "vgmpi.kernels.rigid.prescribed_transfer": {"set_prescribed_velocity": "return"},
    "vgmpi.kernels.colliders.moving_colliders": {},
    "vgmpi.kernels.colliders.sdf_sampling": {},
    "vgmpi.kernels.rigid.prescribed_motion": {"_none": KEPT},
    "vgmpi.features.releases.coupling": {"start": "return None"},
    "vgmpi.features.prescribed_motion.coupling": {"start": "return None"},
    "vgmpi.features.moving_colliders.coupling": {"start": "return None"},
    "vgmpi.preprocess.motion_checks": {
        "validate_collider_motion": "return []",
        "validate_body_motion": "return []",
        "motion_steps": "return np.zeros(0)",
    },
    "vgmpi.features.rigid_bodies.joint_rows": {},
    "vgmpi.features.rigid_bodies.joint_impulses": {},
    "vgmpi.features.rigid_bodies.jointed_bodies": {},
    "vgmpi.features.rigid_bodies.free_bodies": {},
    "vgmpi.features.rigid_bodies.free_coupling": {},
    "vgmpi.features.rigid_bodies.surface_points": {},
    "vgmpi.features.rigid_bodies.body_contact": {},
    "vgmpi.features.rigid_bodies.contact_search": {},
    "vgmpi.features.rigid_bodies.contact_sweeps": {},
    "vgmpi.kernels.nodal_fields.velocity_gradient": {
        "surface_kind": KEPT,
        "_normal": KEPT,
        "_shear": KEPT,
    },
    "vgmpi.kernels.nodal_fields.body_fields": {},
    "vgmpi.kernels.colliders.surface_flow": {},
    "vgmpi.scene.scene_feature": {
        "features": "return ()",
        "_with_keys": KEPT,
        "object_table": KEPT,
        "section_tables": KEPT,
        "table_lists": KEPT,
        "check_object": KEPT,
        "prepare_features": KEPT,
    },
    "vgmpi.features.thin_walls.kernels": {},
    "vgmpi.features.thin_walls.coupling": {},
    "vgmpi.features.surface_slip.coupling": {},
}
PLAIN = """
[domain]
size = [0.32, 0.32, 0.32]
cell = 0.02
[time]
end = 0.05
[accuracy]
precision = "single"
[material.water]
kind = "fluid"
tait_coefficient = 5e4
[material.toy]
kind = "elastic"
youngs_modulus = 1e5
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.16, 0.16, 0.16]] }
[[object]]
name = "toy"
material = "toy"
shape = { box = [[0.16, 0, 0], [0.24, 0.16, 0.16]] }
"""
ABSENT = 'raise RuntimeError("this feature does not exist here")'


def stripped(folder: Path) -> Path:
    """The copy, below a folder."""
    tree = folder / "stripped"
    shutil.copytree(HERE, tree / "vgmpi", ignore=shutil.ignore_patterns("__pycache__"))
    for name in LEFT_OUT:
        _file(tree, name).unlink()
    for name, answers in ANSWERS.items():
        path = _file(tree, name)
        path.write_text(without(path.read_text(), answers))
    return tree


def _file(tree: Path, module: str) -> Path:
    return tree / (module.replace(".", "/") + ".py")


def without(text: str, answers: dict[str, str]) -> str:
    """A module's text whose functions raise, or answer as told by their names. Raises KeyError
    where there is no function of such a name."""
    module = ast.parse(text)
    functions = {node.name for node in ast.walk(module) if isinstance(node, ast.FunctionDef)}
    for name in answers:
        if name not in functions:
            raise KeyError(name)
    for node in ast.walk(module):
        if isinstance(node, ast.FunctionDef):
            answer = answers.get(node.name, ABSENT)
            node.body = ast.parse(answer).body or node.body
    return ast.unparse(module)


def same_bits(tree: Path, folder: Path) -> bool:
    """Whether a scene that has none of the features comes to the same there. Raises BenchError
    where it does not run."""
    found = []
    for name, code in (("here", HERE.parent), ("there", tree)):
        place = folder / name
        place.mkdir()
        (place / "scene.toml").write_text(PLAIN)
        words = [sys.executable, "-m", "vgmpi", "scene.toml", "-q", "--ranks", "1"]
        env = {**os.environ, "PYTHONPATH": str(code)}
        made = subprocess.run(words, cwd=place, env=env, capture_output=True, text=True)
        if made.returncode:
            raise BenchError(f"{code}: {(made.stderr.splitlines() or ['failed'])[-1]}")
        found.append(RunReader(place / "out").frame(-1))
    ours, theirs = found
    return ours.keys() == theirs.keys() and all(
        np.array_equal(ours[key], theirs[key]) for key in ours
    )
