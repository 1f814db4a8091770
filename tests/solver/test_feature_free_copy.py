"""A copy of the program in which features do not exist: it knows a plain scene and nothing else."""

import os
import subprocess
import sys

import pytest

from tests.benchmarks import feature_free_copy

SAND = '[material.sand]\nkind = "sand"\n'
MIXES = '[[coupling]]\nbetween = ["water", "toy"]\nkind = "mixing"\n'


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    return feature_free_copy.stripped(tmp_path_factory.mktemp("copy"))


@pytest.mark.parametrize(
    ("more", "code", "said"),
    [
        ("", 0, "0 errors, 0 warnings"),
        (SAND, 2, "material.sand.kind: must be one of"),
        (MIXES, 2, "coupling"),
    ],
    ids=["plain", "sand", "mixing"],
)
def test_what_is_left_out_is_not_there(tree, tmp_path, more, code, said):
    (tmp_path / "scene.toml").write_text(feature_free_copy.PLAIN + more)
    made = subprocess.run(
        [sys.executable, "-m", "vgmpi", "scene.toml", "--check"],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(tree)}, capture_output=True, text=True,
    )  # fmt: skip
    print(made.stdout, made.stderr)
    assert made.returncode == code and said in made.stdout + made.stderr


def test_a_function_answers_or_raises_and_keeps_its_decorators():
    text = (
        "@inline\ndef f(a):\n    return a\n\ndef g(b):\n    return b\n\ndef h(c):\n    return c\n"
    )
    scope = {"inline": lambda function: lambda a: ("inline", function(a))}
    exec(feature_free_copy.without(text, {"f": "return None", "h": feature_free_copy.KEPT}), scope)
    assert scope["f"](1) == ("inline", None) and scope["h"](3) == 3
    with pytest.raises(RuntimeError, match="does not exist"):
        scope["g"](2)
    with pytest.raises(KeyError, match="gone"):
        feature_free_copy.without(text, {"gone": "return None"})
