"""Rules of the house that a reader relies on: imports, packages and prints.

Every import statement counts, also those inside functions.
"""

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.house.imports import list_imports
from tests.house.source_file import PROGRAM, ROOT, SourceFile, list_files

OUTSIDE = {  # packages that only some files may use
    "postprocess": (),  # its name is vgmpi.postprocess
    "mpi4py": ("vgmpi/parallel/communicator.py", "vgmpi/io/"),
    "h5py": ("vgmpi/io/",),
    "numba": (
        "vgmpi/runtime/",
        "vgmpi/gaussians/",
        "vgmpi/features/",
        "vgmpi/materials/tensor_math/",
        "vgmpi/kernels/",
        "postprocess/raster/",
        "vgmpi/tools/bench/numba_baseline.py",
        "vgmpi/solver/engines/cuda/",
    ),
    "llvmlite": (
        "vgmpi/runtime/callee_code.py",
        "vgmpi/runtime/cpu_features.py",
        "vgmpi/kernels/simd/",
    ),
    "pyvista": (
        "postprocess/commands/view.py",
        "postprocess/commands/export.py",
        "vgmpi/tools/photo/visual_hull.py",
        "vgmpi/tools/notebook/opened_run.py",
    ),
    "vtkmodules": ("vgmpi/preprocess/meshes/reader_process.py",),  # a process of its own
    "pxr": ("postprocess/export/usd_stage.py",),  # OpenUSD: one file of a moving run
    "pysplashsurf": ("postprocess/export/particle_surface.py",),  # surfaces: vgmpi export --surface
    "viser": ("postprocess/live/guarded_server.py",),
    # the part of viser's server that opens its port
    "websockets": ("postprocess/live/guarded_server.py",),
    "tqdm": (
        "postprocess/frames/frame_progress.py",
        "vgmpi/solver/diagnostics/progress.py",
        "vgmpi/solver/compile_kernels.py",
        "vgmpi/tools/tradeoff/study_runs.py",
        "postprocess/commands/",
        "postprocess/export/",
    ),
    "taichi": ("vgmpi/tools/bench/taichi_baseline.py",),
    "warp": (
        "vgmpi/tools/bench/warp_baseline.py",
        "vgmpi/tools/bench/board/newton_board_solver.py",
    ),
    # rivals of the board, in an environment of their own
    "newton": ("vgmpi/tools/bench/board/newton_board_solver.py",),
    "genesis": ("vgmpi/tools/bench/board/genesis_board_solver.py",),
    "gsply": ("vgmpi/gaussians/formats/ply.py",),
    "torch": (
        "vgmpi/tools/bench/board/genesis_board_solver.py",
        "postprocess/raster/gsplat_backend.py",
        "vgmpi/tools/photo/learned/",
        "vgmpi/tools/fit/video_prior/",
    ),
    "transformers": ("vgmpi/tools/photo/learned/", "vgmpi/tools/fit/video_prior/"),
    "diffusers": ("vgmpi/tools/fit/video_prior/",),
    "cv2": ("vgmpi/tools/photo/grabcut.py",),
    "skimage": ("vgmpi/tools/photo/example_photographs.py",),  # photographs of vgmpi photo --demo
    # writes into files of people without touching what they wrote there
    "tomlkit": ("vgmpi/tools/photo/layout_text.py", "postprocess/live/saved_camera.py"),
    "gsplat": ("postprocess/raster/gsplat_backend.py",),
}
COMPILED = (
    "vgmpi/features/",
    "vgmpi/materials/tensor_math/",
    "vgmpi/kernels/",
    "vgmpi/runtime/",
    "vgmpi/parallel/sort_kernels.py",
    "vgmpi/parallel/halo_exchange.py",
    "vgmpi/parallel/load_balance.py",
    "vgmpi/parallel/block_lattice.py",
    "vgmpi/parallel/block_ownership.py",
    "vgmpi/parallel/node_overlap.py",
    "vgmpi/tools/bench/numba_baseline.py",
    "vgmpi/tools/bench/roofline.py",
    "vgmpi/tools/photo/background_inpainting.py",  # searches for patches of a picture
)
PRINT = (
    "postprocess/commands/",
    "vgmpi/commands/command_table.py",
    "vgmpi/commands/check_command.py",
    "vgmpi/commands/cli.py",
    "vgmpi/commands/messages.py",
    "vgmpi/commands/plan_command.py",
    "vgmpi/commands/run_report.py",
    "vgmpi/tools/bench/__main__.py",
    "vgmpi/tools/bench/board/board_command.py",
    "vgmpi/tools/bench/board/board_run.py",
    "vgmpi/tools/bench/subcommands.py",
    "vgmpi/tools/convert/__main__.py",
    "vgmpi/tools/photo/__main__.py",
    "vgmpi/tools/fit/__main__.py",
    "vgmpi/tools/tradeoff/energy_drift.py",
    "vgmpi/tools/tradeoff/setting_study.py",
)


SOURCES = list_files(*PROGRAM)


def is_module(name):
    path = ROOT / name.replace(".", "/")
    return path.with_suffix(".py").is_file() or path.is_dir()


def imports(file):
    """Full names of all that a file imports."""
    return list_imports(SourceFile(file), is_module)


def forbidden(file, imported):
    """Return why a file may not import these modules, as a list of lines."""
    errors = []
    for name in sorted(imported):
        top = name.split(".")[0]
        if top in OUTSIDE and not file.startswith(OUTSIDE[top]):
            errors.append(f"{file} imports {top}")
        if name.startswith("vgmpi.runtime.jit") and not file.startswith(COMPILED):
            errors.append(f"{file} compiles code")
    return errors


@pytest.mark.parametrize("file", SOURCES)
def test_packages_are_used_in_their_rooms(file):
    assert forbidden(file, imports(file)) == []


@pytest.mark.parametrize(
    "file, imported",
    [
        ("vgmpi/solver/simulation.py", "mpi4py"),
        ("vgmpi/planning/plan.py", "numba"),
        ("vgmpi/solver/simulation.py", "vgmpi.runtime.jit"),
        ("vgmpi/preprocess/scene_builder.py", "h5py"),
        ("vgmpi/tools/bench/vgmpi_contestant.py", "numba"),
        ("vgmpi/tools/bench/vgmpi_contestant.py", "vgmpi.runtime.jit"),
        ("vgmpi/tools/bench/interleaved_rounds.py", "taichi"),
        ("vgmpi/tools/bench/taichi_baseline.py", "warp"),
        ("postprocess/raster/rasterize.py", "torch"),
        ("postprocess/studio/density_field.py", "vgmpi.runtime.jit"),
        ("vgmpi/tools/photo/object_masks.py", "transformers"),
        ("vgmpi/tools/fit/sds_descent.py", "torch"),
        ("vgmpi/preprocess/meshes/bounded_reader.py", "vtkmodules"),
        ("vgmpi/tools/fit/__main__.py", "diffusers"),
        ("vgmpi/tools/fit/target_base.py", "postprocess.frames.frame_renderer"),
    ],
)
def test_the_rule_sees_a_wrong_import(file, imported):
    assert forbidden(file, {imported}) != []


CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
ROOMS = CONTRACTS["contracts"][0]["layers"]


def linted(root):
    """Return the exit code and the text of import-linter on a tree."""
    job = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-logo", "--no-cache"],
        cwd=root,
        env=os.environ | {"PYTHONPATH": str(root), "COLUMNS": "200"},
        capture_output=True,
        text=True,
    )
    return job.returncode, job.stdout + job.stderr


def test_imports_keep_the_contracts():
    code, text = linted(ROOT)
    assert code == 0, text


PLANTED = (  # importer, imported, contract
    ("vgmpi.parallel.halo_exchange", "vgmpi.solver.engines.cpu", "rooms import"),
    ("vgmpi.materials.newtonian_fluid", "vgmpi.scene.loader", "rooms import"),
    ("vgmpi.runtime.cpu_features", "vgmpi.gaussians.cloud", "rooms import"),
    ("vgmpi.solver.run", "vgmpi.tools.photo.pipeline", "rooms import"),
    ("vgmpi.solver.engines.cpu", "vgmpi.solver.simulation", "engines do not"),
    ("vgmpi.postprocess.frames.frame_renderer", "vgmpi.scene.loader", "the renderer reads"),
    ("vgmpi.features.reactions.coupling", "vgmpi.solver.engines.cpu", "rooms import"),
    ("vgmpi.features.releases.coupling", "vgmpi.features.thin_walls.coupling", "features do not"),
    ("vgmpi.solver.simulation", "mpi4py", "only parallel and io"),
    ("vgmpi.commands.start", "vgmpi.tools.fit.workflow", "rooms import"),
    ("vgmpi.tools.fit.workflow", "vgmpi.commands.start", "rooms import"),
    ("vgmpi.commands.start", "vgmpi.postprocess.web.web_page", "a run needs no"),
    ("vgmpi.postprocess.live.live_page", "vgmpi.postprocess.commands.live", "folders of the"),
    ("vgmpi.postprocess.web.web_page", "vgmpi.parallel.launch", "of parallel"),
)


def test_contracts_see_planted_imports(tmp_path):
    for name in ("vgmpi", "postprocess"):
        copied = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, tmp_path / name, symlinks=True, ignore=copied)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for importer, imported, _ in PLANTED:
        with open(tmp_path / f"{importer.replace('.', '/')}.py", "a") as file:
            file.write(f"\nimport {imported}\n")
    code, text = linted(tmp_path)
    assert code != 0
    for importer, imported, contract in PLANTED:
        assert any(row.startswith(contract) and " BROKEN" in row for row in text.splitlines())
        (section,) = re.findall(
            rf"^{contract}[^\n]*\n--+\n(.*?)(?=\n\n\n\S[^\n]*\n--+\n|\Z)", text, re.M | re.S
        )
        assert f"{importer} -> {imported} (" in section, (importer, imported)


def test_the_house_has_its_rooms_and_six_files_at_its_door():
    rooms = {path.name for path in (ROOT / "vgmpi").iterdir() if (path / "__init__.py").exists()}
    files = {path.name for path in (ROOT / "vgmpi").iterdir() if path.is_file()}
    assert rooms == set(re.findall(r"vgmpi\.(\w+)", " ".join(ROOMS))) - {"api"}
    assert len(rooms) <= 15 and len(files) <= 6


def test_the_renderer_has_one_name():
    """In a checkout a link gives it the name that it has in a wheel; in its folder it has none."""
    assert os.readlink(ROOT / "vgmpi" / "postprocess") == "../postprocess"
    for path in list_files("postprocess"):
        nodes = SourceFile(path).nodes
        origins = [n.module or "" for n in nodes if isinstance(n, ast.ImportFrom) and not n.level]
        assert not [name for name in origins if name.startswith("vgmpi.postprocess")], path


def test_imports_are_found():
    """All the ways to write one."""
    text = "from .. import plan\nfrom . import run\nfrom .run import Run\nimport a.b as c\n"
    text += "def f():\n    from ..plan import make_plan\n"
    modules = {"vgmpi.plan", "vgmpi.solver.run"}
    imported = list_imports(SourceFile("vgmpi/solver/x.py", text), modules.__contains__)
    assert imported == {"vgmpi.plan", "vgmpi.solver.run", "a.b"}


def prints(file):
    """Lines that print, outside `if __name__ == "__main__"`."""
    tree = ast.parse((ROOT / file).read_text())
    commands = [
        node
        for node in tree.body
        if isinstance(node, ast.If) and "__name__" in ast.unparse(node.test)
    ]
    allowed = {id(inner) for command in commands for inner in ast.walk(command)}
    return [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "print"
        and id(node) not in allowed
    ]


@pytest.mark.parametrize("file", SOURCES)
def test_only_commands_print(file):
    assert file.startswith(PRINT) or prints(file) == []


def test_a_print_is_seen():
    assert prints("vgmpi/commands/cli.py") and prints("postprocess/commands/render.py")


@pytest.mark.parametrize("file", [f for f in SOURCES if f.endswith("__init__.py")])
def test_reading_a_folder_reads_nothing_else(file):
    """Only materials and couplings look for what is in their folder; vgmpi names what scripts use,
    and loads it when asked for."""
    folders = ("vgmpi", "vgmpi/materials", "vgmpi/materials/couplings")
    discovers = file in [f"{folder}/__init__.py" for folder in folders]
    assert discovers == bool((ROOT / file).read_text().strip())


@pytest.mark.parametrize(
    "module, absent",
    [
        ("vgmpi", "numpy"),  # its names are loaded when asked for
        ("vgmpi.api", "numba"),
        ("vgmpi.commands.command_table", "numpy"),  # --help is quick
        ("vgmpi.commands.cli", "numba mpi4py.MPI"),  # --check and --help stay quick
        ("vgmpi.io.run_reader", "numba mpi4py"),
        ("vgmpi.gaussians.formats.registry", "numba"),
        # a rival's process holds nothing but its own tool
        ("vgmpi.tools.bench.dense_grid_baseline", "numba"),
        ("vgmpi.postprocess.commands.view", "mpi4py"),
        ("vgmpi.postprocess.commands.render", "mpi4py"),
        ("vgmpi.tools.fit.__main__", "torch"),
    ],
)
def test_what_is_not_loaded(module, absent):
    code = f"import {module}, sys; sys.exit(any(name in sys.modules for name in {absent.split()}))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
