"""The house rules that a reader relies on: who imports whom, who speaks MPI, who prints, and how
long things are.

Every import statement counts, also those inside functions.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# each may import itself and what stands below it
LAYERS = [
    {"images"},
    {"fit"},
    {"study"},
    {"bench"},
    {"cli", "__main__", "api"},
    {"solver"},
    {"prepare"},
    {"engines"},
    {"kernels"},
    {"lanes"},
    {"output"},
    {"domain"},
    {"planning"},
    {"convert"},
    {"scene"},
    {"materials", "couplings"},
    {"camerafiles"},
    {"source"},
    {"tables"},
    {"inputs"},
    {"device"},
    {"studio"},
    {"splatting"},
    {"gaussians"},
    {"caching"},
    {"ends"},
    {"room"},
    {"misspelt"},
]
# the layers that may be used, where that is less than all below
ONLY = {
    "images": {
        "prepare", "convert", "scene", "materials", "source", "tables", "inputs", "splatting",
        "gaussians", "ends", "room", "misspelt", "camerafiles",
    },
    "materials": {"tables", "device", "misspelt"},
    "couplings": {"tables", "device"},
    "source": {"tables", "inputs"},
    "tables": {"misspelt"},
}  # fmt: skip
POSTPROCESS = (
    "vgmpi.output.read",
    "vgmpi.output.layout",
    "vgmpi.gaussians",
    "vgmpi.splatting",
    "vgmpi.studio",
    "vgmpi.domain.ranks",  # frames shared by the ranks of a launcher
    "vgmpi.source",  # render.toml is read as a scene is, and its mistakes are told the same way
    "vgmpi.tables",
    "vgmpi.inputs",
    "vgmpi.misspelt",
    "vgmpi.camerafiles",
    "vgmpi.caching",
    "vgmpi.ends",
    "vgmpi.room",
    "postprocess",
)
DRAWN_BY = ("vgmpi/fit/",)  # what compares runs with pictures lets the renderer draw them
OUTSIDE = {  # packages that only some files may use
    "mpi4py": ("vgmpi/domain/ranks.py", "vgmpi/output/"),
    "h5py": ("vgmpi/output/",),
    "numba": (
        "vgmpi/caching.py",
        "vgmpi/device/",
        "vgmpi/kernels/",
        "vgmpi/lanes/",
        "vgmpi/splatting/",
        "vgmpi/studio/",
        "vgmpi/bench/plain.py",
        "vgmpi/bench/spills.py",
        "vgmpi/engines/cuda/",
        "postprocess/",
    ),
    "llvmlite": (
        "vgmpi/bench/spills.py",
        "vgmpi/device/processor.py",
        "vgmpi/lanes/",
    ),
    "pyvista": ("postprocess/", "vgmpi/images/hull.py"),
    "viser": ("postprocess/replay.py",),
    "tqdm": ("vgmpi/solver/report.py", "vgmpi/study/runs.py", "postprocess/"),
    "taichi": ("vgmpi/bench/taichi_rival.py",),
    "warp": ("vgmpi/bench/warp_rival.py",),
    "gsply": ("vgmpi/gaussians/ply.py",),
    "torch": ("vgmpi/splatting/gsplat_backend.py", "vgmpi/images/learned/", "vgmpi/fit/taste/"),
    "transformers": ("vgmpi/images/learned/", "vgmpi/fit/taste/"),
    "diffusers": ("vgmpi/fit/taste/",),
    "cv2": ("vgmpi/images/masks.py",),
    "tomlkit": ("vgmpi/images/layout.py",),
    "gsplat": ("vgmpi/splatting/gsplat_backend.py",),
}
COMPILED = (
    "vgmpi/device/",
    "vgmpi/kernels/",
    "vgmpi/lanes/",
    "vgmpi/domain/sorting.py",
    "vgmpi/domain/halo.py",
    "vgmpi/domain/balance.py",
    "vgmpi/domain/blocks.py",
    "vgmpi/domain/census.py",
    "vgmpi/domain/overlap.py",
    "vgmpi/domain/sampled.py",
    "vgmpi/bench/plain.py",
    "vgmpi/bench/roof.py",
)
# how much of a thing a reader can hold at once
LINES_OF_A_FILE, LINES_OF_A_FUNCTION, ARGUMENTS, POSITIONS = 400, 60, 12, 8
# where nine numbers are the entries of one thing, a 3x3 tensor, row by row
TENSORS = (
    "vgmpi/device/",
    "vgmpi/kernels/",
    "vgmpi/engines/cuda/",
    "vgmpi/gaussians/evolve.py",
    "vgmpi/studio/normals.py",
    "postprocess/shade.py",
)
# what is still too large; a line goes when it is mended, and none comes
PRINT = (
    "vgmpi/cli.py",
    "vgmpi/bench/__main__.py",
    "vgmpi/bench/commands.py",
    "vgmpi/bench/studies.py",
    "vgmpi/convert/__main__.py",
    "vgmpi/images/__main__.py",
    "vgmpi/fit/__main__.py",
    "vgmpi/study/__main__.py",
    "vgmpi/study/energy.py",
    "vgmpi/study/tradeoff.py",
)


def sources():
    files = [*ROOT.glob("vgmpi/**/*.py"), *ROOT.glob("postprocess/**/*.py")]
    return sorted(str(path.relative_to(ROOT)) for path in files)


def is_module(name):
    path = ROOT / name.replace(".", "/")
    return path.with_suffix(".py").is_file() or path.is_dir()


def imports(file):
    """Full names of all that a file imports: modules, and names out of packages where these are
    modules.
    """
    package = file.removesuffix(".py").split("/")[:-1]
    found = set()
    for node in ast.walk(ast.parse((ROOT / file).read_text())):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            origin = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                inner = f"{origin}.{alias.name}"
                found.add(inner if is_module(inner) else origin)
    return found


def part(name):
    """kernels for vgmpi.kernels.grid or vgmpi/kernels/grid.py."""
    return name.removesuffix(".py").replace("/", ".").split(".")[1]


def level(name):
    return next(k for k, layer in enumerate(LAYERS) if name in layer)


def forbidden(file, imported):
    """Why a file may not import these, as a list of lines."""
    said = []
    for name in sorted(imported):
        top = name.split(".")[0]
        if top in OUTSIDE and not file.startswith(OUTSIDE[top]):
            said.append(f"{file} imports {top}")
        if name.startswith("vgmpi.device.jit") and not file.startswith(COMPILED):
            said.append(f"{file} compiles code")
        if file.startswith("postprocess/"):
            if top in ("vgmpi", "postprocess") and not name.startswith(POSTPROCESS):
                said.append(f"{file} imports {name}")
        elif top == "postprocess" and not file.startswith(DRAWN_BY):
            said.append(f"{file} imports {name}")
        elif top == "vgmpi" and name != "vgmpi":
            here, there = part(file), part(name)
            if here == there:
                continue
            reachable = level(there) > level(here) or LAYERS[level(here)] == LAYERS[level(there)]
            if not reachable or there not in ONLY.get(here, {there}):
                said.append(f"{file} imports {name}")
    return said


def test_the_layers_name_every_module():
    there = {part(file) for file in sources() if file.startswith("vgmpi/")} - {"__init__"}
    assert there == set().union(*LAYERS)


@pytest.mark.parametrize("file", sources())
def test_imports_run_one_way(file):
    assert forbidden(file, imports(file)) == []


@pytest.mark.parametrize(
    "file, imported",
    [
        ("vgmpi/domain/halo.py", "vgmpi.engines.cpu"),
        ("vgmpi/materials/fluid.py", "vgmpi.scene"),
        ("vgmpi/device/tensor.py", "vgmpi.tables"),
        ("vgmpi/couplings/contact.py", "vgmpi.gaussians.sh"),
        ("vgmpi/gaussians/sh.py", "vgmpi.device.tensor"),
        ("vgmpi/solver/step.py", "mpi4py"),
        ("vgmpi/solver/step.py", "vgmpi.cli"),
        ("vgmpi/planning/plan.py", "numba"),
        ("vgmpi/solver/step.py", "vgmpi.device.jit"),
        ("vgmpi/prepare/build.py", "h5py"),
        ("postprocess/render.py", "vgmpi.lanes.laws"),
        ("postprocess/render.py", "vgmpi.output.store"),
        ("postprocess/settings.py", "vgmpi.scene.reader"),
        ("vgmpi/source.py", "vgmpi.device.tensor"),
        ("vgmpi/scene/scene.py", "postprocess.render"),
        ("vgmpi/cli.py", "vgmpi.bench.rounds"),
        ("vgmpi/bench/own.py", "numba"),
        ("vgmpi/bench/own.py", "vgmpi.device.jit"),
        ("vgmpi/bench/rounds.py", "taichi"),
        ("vgmpi/bench/taichi_rival.py", "warp"),
        ("vgmpi/splatting/splat.py", "torch"),
        ("vgmpi/splatting/splat.py", "vgmpi.studio.field"),
        ("vgmpi/studio/field.py", "vgmpi.device.jit"),
        ("vgmpi/solver/run.py", "vgmpi.images.made"),
        ("vgmpi/images/made.py", "vgmpi.solver.run"),
        ("vgmpi/images/found.py", "transformers"),
        ("vgmpi/fit/descent.py", "torch"),
        ("vgmpi/fit/targets.py", "diffusers"),
    ],
)
def test_the_rule_sees_a_wrong_import(file, imported):
    assert forbidden(file, {imported}) != []


def test_imports_are_found(monkeypatch, tmp_path):
    """All the ways to write one."""
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    folder = tmp_path / "vgmpi" / "solver"
    folder.mkdir(parents=True)
    (tmp_path / "vgmpi" / "plan.py").touch()
    (folder / "run.py").touch()
    text = "from .. import plan\nfrom . import run\nfrom .run import Run\nimport a.b as c\n"
    (folder / "x.py").write_text(text + "def f():\n    from ..plan import make_plan\n")
    assert imports("vgmpi/solver/x.py") == {"vgmpi.plan", "vgmpi.solver.run", "a.b"}


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


@pytest.mark.parametrize("file", [f for f in sources() if f.startswith("vgmpi/")])
def test_only_commands_print(file):
    assert file in PRINT or prints(file) == []


def test_a_print_is_seen():
    assert prints("vgmpi/cli.py") and prints("postprocess/render.py")


def everything():
    """All Python files: the program, the tools, the tests and the made scenes."""
    folders = ("vgmpi", "postprocess", "tests", "runs")
    files = [path for folder in folders for path in ROOT.glob(f"{folder}/**/*.py")]
    return sorted(str(path.relative_to(ROOT)) for path in files)


@pytest.mark.parametrize("file", everything())
def test_files_are_short(file):
    assert len((ROOT / file).read_text().splitlines()) <= LINES_OF_A_FILE


def positions(function):
    """How many things stand side by side where only their order tells them apart: the longest
    tuple that a function returns, or takes apart into names."""
    shown = [node.value for node in ast.walk(function) if isinstance(node, ast.Return)]
    named = [
        node
        for node in ast.walk(function)
        if isinstance(node, ast.Tuple) and isinstance(node.ctx, ast.Store)
    ]
    tuples = [node for node in shown + named if isinstance(node, ast.Tuple)]
    return max((len(node.elts) for node in tuples), default=0)


def too_large(file, text):
    """What no reader can hold, as "file: function: lines", "... arguments", "... positions"."""
    most = 9 if file.startswith(TENSORS) else POSITIONS
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            arguments = len(given.posonlyargs + given.args + given.kwonlyargs)
            arguments += (given.vararg is not None) + (given.kwarg is not None)
            wrong = {
                "lines": node.end_lineno - node.lineno + 1 > LINES_OF_A_FUNCTION,
                "arguments": arguments > ARGUMENTS,
                "positions": positions(node) > most,
            }
            found |= {f"{file}: {node.name}: {what}" for what, is_so in wrong.items() if is_so}
    return found


@pytest.mark.parametrize("file", everything())
def test_functions_can_be_held(file):
    """Anything larger wants a name for its parts: a second function, a NamedTuple."""
    assert not too_large(file, (ROOT / file).read_text())


@pytest.mark.parametrize(
    "text, what",
    [
        ("def f():\n" + 60 * "    x = 1\n", "lines"),
        ("def f(a, b, c, d, e, f, *, g, h, i, j, k, l, m): ...", "arguments"),
        ("def f(a, b, c, d, e, f, g, h, i, j, k, *l, **m): ...", "arguments"),
        ("def f(): return 1, 2, 3, 4, 5, 6, 7, 8, 9", "positions"),
        ("def f(x): a, b, c, d, e, f, g, h, i = x", "positions"),
        ("def f(x):\n    for a, b, c, d, e, f, g, h, i in x: ...", "positions"),
    ],
)
def test_the_rule_sees_what_is_too_large(text, what):
    assert too_large("vgmpi/cli.py", text) == {f"vgmpi/cli.py: f: {what}"}


def test_a_tensor_is_one_thing():
    text = "def f(): return 1, 2, 3, 4, 5, 6, 7, 8, 9"
    assert too_large("vgmpi/device/tensor.py", text) == set()


@pytest.mark.parametrize("file", [f for f in sources() if f.endswith("__init__.py")])
def test_reading_a_folder_reads_nothing_else(file):
    """Only materials and couplings look for what is in their folder; vgmpi names what scripts use,
    and loads it when asked for."""
    folders = ("vgmpi", "vgmpi/materials", "vgmpi/couplings")
    discovers = file in [f"{folder}/__init__.py" for folder in folders]
    assert discovers == bool((ROOT / file).read_text().strip())


@pytest.mark.parametrize(
    "module, absent",
    [
        ("vgmpi", "numpy"),  # its names are loaded when asked for
        ("vgmpi.api", "numba"),
        ("vgmpi.cli", "numba"),  # --check and --help stay quick
        ("vgmpi.cli", "mpi4py.MPI"),  # and start no MPI
        ("vgmpi.output.read", "numba"),
        ("vgmpi.output.read", "mpi4py"),
        ("vgmpi.gaussians.files", "numba"),
        ("vgmpi.bench.dense", "numba"),  # a rival's process holds nothing but its own tool
        ("postprocess.view", "mpi4py"),
        ("postprocess.render", "mpi4py"),
        ("vgmpi.fit.__main__", "torch"),
    ],
)
def test_what_is_not_loaded(module, absent):
    code = f"import {module}, sys; sys.exit({absent!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
