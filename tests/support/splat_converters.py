"""Conversions of Gaussian files by other programs, as a module and as a script.

The folder in the variable VGMPI_SPLAT_TOOLS has the programs; install_splat_tools.sh fills it. As a
script: python splat_converters.py PROGRAM SOURCE TARGET. It needs nothing of this project.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
VARIABLE = "VGMPI_SPLAT_TOOLS"
VERSIONS = {
    "splat-transform": "3.7.0",
    "gsply": "0.4.6",
    "gaussforge": "0.6.0",
    "@adobe/spz": "0.2.3",
    "spz-js": "1.2.5",
    "@mkkellogg/gaussian-splats-3d": "0.4.7",
    "gsplat2usd": "0.1.5",
    "three": "0.187.0",
    "gltf-validator": "2.0.0-dev.3.10",
}
PATIENCE = 300  # [s] for one program


def tools_folder():
    """The folder of the programs, or None."""
    folder = os.environ.get(VARIABLE)
    return Path(folder) if folder and (Path(folder) / "complete").exists() else None


def convert_all(jobs):
    """Convert files; jobs: (program, source, target). Returns the error of each, "" without one."""
    folder = tools_folder()
    assert folder is not None, f"{VARIABLE} names no folder that install_splat_tools.sh filled"
    jobs = [(program, *(str(Path(path).absolute()) for path in paths)) for program, *paths in jobs]
    errors = {}
    by_program = {}
    for job in jobs:
        by_program.setdefault(job[0], []).append(job)
    for program, group in by_program.items():
        if program == "splat-transform":
            found = [_by_splat_transform(folder, *job[1:]) for job in group]
        elif program in PYTHON:
            found = _by_python(folder, group)
        else:
            found = _by_node(folder, group)
        errors |= dict(zip(group, found, strict=True))
    return [errors[job] for job in jobs]


def _run(command, **more):
    run = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, **more)
    return run.returncode, run.stdout, run.stderr.strip()


def _by_splat_transform(folder, source, target):
    version = "3" if target.endswith("-3.spz") else "4"
    program = folder / "node_modules" / ".bin" / "splat-transform"
    options = ["-q", "-w", "-g", "cpu", "--spz-version", version]
    code, _, said = _run([program, *options, source, target])
    return said or f"exit code {code}" if code else ""


def _by_node(folder, jobs):
    path = Path(jobs[0][2] + ".jobs")
    path.write_text(json.dumps(jobs))
    command = ["node", "--no-deprecation", "--input-type=module", "-", str(path)]
    source = (HERE / "splat_converters.mjs").read_text()
    code, out, said = _run(command, cwd=folder, input=source)
    path.unlink()
    assert code == 0, said
    return json.loads(out.splitlines()[-1])


def _by_python(folder, jobs):
    path = Path(jobs[0][2] + ".jobs")
    path.write_text(json.dumps(jobs))
    search = os.pathsep.join([str(folder / "python"), os.environ.get("PYTHONPATH", "")])
    code, out, said = _run(
        [sys.executable, __file__, str(path)], env=os.environ | {"PYTHONPATH": search}
    )
    path.unlink()
    assert code == 0, said
    return json.loads(out.splitlines()[-1])


def _with_gsply(source, target):
    import gsply
    from gsply import sog_reader
    from gsply.spz import read_spz, write_spz

    if source.endswith(".spz"):
        cloud = read_spz(source)
    elif source.endswith(".sog"):
        sog_reader.imagecodecs = _Pictures  # it is heavy, and pillow reads WebP as well
        cloud = sog_reader.sogread(source)
    else:
        cloud = gsply.plyread(source)
    if target.endswith(".spz"):
        write_spz(target, cloud, version=3 if target.endswith("-3.spz") else 4)
    else:
        gsply.plywrite(target, cloud, compressed=target.endswith(".compressed.ply"))


class _Pictures:
    """What gsply wants of imagecodecs."""

    @staticmethod
    def webp_decode(data):
        import io

        from PIL import Image

        return np.array(Image.open(io.BytesIO(data)).convert("RGBA"))


def _with_gaussforge(source, target):
    import gaussforge

    def kind(path):
        return "compressed.ply" if path.endswith(".compressed.ply") else path.rsplit(".", 1)[1]

    version = 4 if target.endswith("-4.spz") else 3
    forge = gaussforge.GaussForge()
    made = forge.convert(Path(source).read_bytes(), kind(source), kind(target), False, version)
    if "error" in made:
        raise ValueError(made["error"])
    Path(target).write_bytes(made["data"])


def _with_gsplat2usd(source, target):
    from gsplat2USD.ply_reader import read_ply
    from gsplat2USD.usd_writer import write_gaussian_splat_usd

    write_gaussian_splat_usd(read_ply(source), target, source_file=source, up_axis="Z")


PYTHON = {
    "gsply": _with_gsply,
    "gaussforge": _with_gaussforge,
    "gsplat2usd": _with_gsplat2usd,
}


def convert_here(jobs):
    """Convert files by packages of this interpreter."""
    errors = []
    for program, source, target in jobs:
        try:
            PYTHON[program](source, target)
            errors.append("")
        except Exception as error:
            errors.append(f"{type(error).__name__}: {error}")
    return errors


def read_table(path):
    """Comments, and columns float64 by name, of a binary .ply with properties of type float."""
    head, data = Path(path).read_bytes().split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    (count,) = (int(line.split()[2]) for line in lines if line.startswith("element vertex "))
    assert "format binary_little_endian 1.0" in lines
    assert sum(line.startswith(("property", "element")) for line in lines) == len(names) + 1
    table = np.frombuffer(data, "<f4", count * len(names)).reshape(count, -1).astype(np.float64)
    comments = [line.removeprefix("comment ") for line in lines if line.startswith("comment")]
    return comments, dict(zip(names, table.T))


if __name__ == "__main__":
    if len(sys.argv) == 2:
        print(json.dumps(convert_here(json.loads(Path(sys.argv[1]).read_text()))))
    else:
        sys.exit(convert_all([sys.argv[1:4]])[0])
