"""Packages that are not installed are named with the line that installs them."""

import sys

import pytest

from tests.support import drawn_photograph
from tests.support.launch import ROOT, run
from vgmpi.tools.photo import material_lookup

BLOCKED = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "{package}":
            raise ImportError(f"No module named '{{name}}'", name=name)
sys.meta_path.insert(0, Blocked())
from vgmpi.tools.photo.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    "package, head, pip",
    [
        ("cv2", "", "pip install 'vgmpi[images]'"),
        ("tomlkit", "", "pip install 'vgmpi[images]'"),
        ("torch", '[masks]\nmethod = "sam2"', "pip install 'vgmpi[learned]'"),
        ("transformers", '[materials]\nmethod = "clip"', "pip install 'vgmpi[learned]'"),
        ("torch", '[depth]\nmethod = "depth-anything"', "pip install 'vgmpi[learned]'"),
    ],
)
def test_a_missing_package_is_one_line(tmp_path, package, head, pip):
    photo, layout = drawn_photograph.put(tmp_path, drawn_photograph.layout(head=head))
    text = layout.read_text()
    code = BLOCKED.format(package=package)
    ended = run([sys.executable, "-c", code, photo, layout, "-o", tmp_path / "out"], cwd=ROOT)
    assert ended.returncode == 2
    lines = ended.stderr.splitlines()
    assert len(set(line.partition(": ")[2] for line in lines)) <= 3 and pip in lines[0], lines
    assert layout.read_text() == text and not (tmp_path / "out").exists()


def test_every_material_of_the_table_is_one_of_the_scene():
    from vgmpi import materials

    for name in material_lookup.material_names():
        keys = material_lookup.material_keys(name)
        materials.registry[keys["kind"]].model_validate(keys)


@pytest.mark.parametrize(
    "name, text, material",
    [
        ("cup", None, "ceramic"),
        ("two oranges", None, "fruit"),
        ("thing 1", "a glass of milk", "ceramic"),
        ("milk", None, "water"),
        ("thing 1", None, "rubber"),
    ],
)
def test_names_tell_materials(name, text, material):
    found, why = material_lookup.guess_from_name(name, text)
    assert found == material and why
