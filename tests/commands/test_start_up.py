"""What a start does not load: packages that most scenes never use, tenths of a second each."""

import subprocess
import sys

import pytest

UNUSED = ("scipy.spatial", "scipy.ndimage", "scipy.stats", "pyvista", "meshio", "matplotlib")


@pytest.mark.parametrize("module", ["vgmpi.commands.run_report", "vgmpi.solver.run"])
def test_a_run_imports_no_package_before_it_uses_it(module):
    code = f"import sys, {module}; print(*(n for n in {UNUSED!r} if n in sys.modules))"
    job = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (job.returncode, job.stdout.strip()) == (0, ""), job.stderr
