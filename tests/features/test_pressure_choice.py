"""The pressure and the viscosity of scenes that name none: chosen from the scene alone."""

import numpy as np
import pytest

import vgmpi
from tests.features.test_implicit_pressure_rules import POST, PUBLISHED_DRAG, SAND, SCENE
from tests.support.simulate import advance, begin, by_id
from vgmpi.commands import cli
from vgmpi.scene.loader import load
from vgmpi.scene.resume_rules import with_accuracy_of_run

POOL = SCENE.replace('[accuracy]\npressure = "implicit"\n', "")
SOFT = """
[material.gum]
kind = "elastic"
density = 700
youngs_modulus = 1e5
[[object]]
name = "ball"
material = "gum"
shape = { sphere = { center = [0.2, 0.1, 0.2], radius = 0.04 } }
"""
RIGID = SOFT.replace('"gum"\nshape', '"gum"\nrigid = true\nshape')
OIL = """
[[object]]
name = "slick"
material = "water"
phase = "slick"
shape = { box = [[0, 0, 0.1], [0.4, 0.2, 0.14]] }
"""
SYRUP = POOL.replace('"fluid"', '"fluid"\nviscosity = 200')
PROBE = '[[probe]]\nname = "push"\nwall = "bottom"\nsampling_rate = 100\n'


def chosen(text, overrides=()):
    """Return the scene of a text."""
    return load("scene.toml", tuple(overrides), text)


def with_accuracy(key, value):
    """Return the pool with a key of [accuracy]."""
    return f"[accuracy]\n{key} = {value!r}\n" + POOL


@pytest.mark.parametrize(
    "text",
    [POOL, POOL + POST, POOL + RIGID, with_accuracy("transfer", "apic")],
    ids=["water", "collider", "rigid", "apic"],
)
def test_liquids_are_implicit_where_steps_become_long(text):
    scene = chosen(text)
    assert scene.accuracy.pressure == "implicit" and scene.accuracy.viscosity == "explicit"
    assert scene.accuracy.transfer == "apic" and scene.accuracy.volume_correction == "none"
    assert scene.courant_number == 0.4 and scene.is_free_of_waves
    (line,) = scene.choices
    assert line.startswith("  pressure    implicit: steps are ")
    assert "pressure" not in scene.accuracy.model_fields_set


@pytest.mark.parametrize(
    "text, reason",
    [
        (POOL + SOFT, "collisions of solids, sand and snow would lose more energy"),
        (POOL.replace('"fluid"', '"fluid"\ntait_coefficient = 100'), "pay from 2.5 times on"),
        (
            (POOL + POST).replace('"fluid"', '"fluid"\nmax_speed = 1\nmax_compression = 0.04'),
            "and pay from 3.5 times on",
        ),
        (with_accuracy("transfer", "aflip"), "need transfer = 'apic': accuracy.transfer (s"),
        (with_accuracy("volume_correction", "shifting"), "need volume_correction = 'none'"),
        (with_accuracy("dilatation", "cells"), "need dilatation = 'particles'"),
        (POOL.replace("end = 0.1", "end = 0.1\ndt = 1e-5"), "no fixed length: time.dt (scene"),
        (POOL + POST + "friction = 0.3\n", "with friction: object.post.friction (scene.toml:19)"),
        (
            POOL.replace('"water"\ns', '"water"\nrelease_time = 0.05\ns'),
            "held or moved, and colliders with friction: object.pool.release_time",
        ),
        (with_accuracy("elasticity", "explicit") + SOFT, "materials that are no fluid"),
        (POOL + SAND + PUBLISHED_DRAG, "couplings of kind 'drag-versagauss'"),
        (POOL + OIL, "gaps open between phases of liquids at rest"),
        (
            POOL + SOFT + "pinned = { box = [[0, 0, 0], [0.4, 0.2, 0.2]], "
            'motion = { keyframes = [{ time = "0.1 s", translation = [0.1, 0, 0] }] } }\n',
            "accuracy.elasticity = 'implicit' is not for pinned parts that move: object.ball.pin",
        ),
    ],
)  # fmt: skip
def test_a_reason_for_an_explicit_pressure(text, reason):
    """The plan names the first one."""
    scene = chosen(text)
    assert scene.accuracy.pressure == scene.accuracy.viscosity == "explicit"
    assert not scene.is_free_of_waves
    (line,) = scene.choices
    assert line.startswith("  pressure    explicit: ") and reason in line


def test_without_a_liquid_nothing_is_chosen_aloud():
    scene = chosen(POOL[: POOL.index("[material")] + SOFT)
    assert scene.accuracy.pressure == scene.accuracy.viscosity == "explicit" and not scene.choices


def test_a_viscosity_follows_an_implicit_pressure():
    both = chosen(SYRUP)
    assert both.accuracy.pressure == both.accuracy.viscosity == "implicit"
    assert [line.split()[0] for line in both.choices] == ["viscosity", "pressure"]
    named = chosen('[accuracy]\npressure = "explicit"\n' + SYRUP)
    assert named.accuracy.viscosity == "explicit"
    thin = chosen(SYRUP.replace("200", "0.1"))
    assert (thin.accuracy.pressure, thin.accuracy.viscosity) == ("implicit", "explicit")
    # where the viscosity stays explicit, it bounds the steps with either pressure
    probed = chosen(SYRUP + PROBE)
    assert probed.accuracy.pressure == probed.accuracy.viscosity == "explicit"


def test_a_plan_tells_the_choice(tmp_path, capsys):
    explicit = with_accuracy("transfer", "aflip")
    for text, start in ((POOL, "implicit: steps are"), (explicit, "explicit: implicit steps")):
        (tmp_path / "scene.toml").write_text(text)
        assert cli.main([str(tmp_path / "scene.toml"), "--plan"]) == 0
        assert f"\n  pressure    {start} " in capsys.readouterr().out


def test_what_is_chosen_is_what_is_named(tmp_path):
    """The same JSON, so the same run; an explicit scene has the transfers it had."""
    for value in ("implicit", "explicit"):
        named = chosen(POOL, [f"accuracy.pressure={value}", "accuracy.viscosity=explicit"])
        own = chosen(POOL).with_choices({"pressure": value, "viscosity": "explicit"})
        assert own.to_json() == named.to_json()
    assert own.accuracy.transfer == "apic-corrected" and own.courant_number == 0.55
    assert own.accuracy.volume_correction == "shifting"


def test_a_resumed_run_keeps_its_pressure():
    """Also one that is older than the keys, whose pressure was explicit."""
    before = chosen(POOL, ["accuracy.pressure=explicit"]).to_json()
    older = {**before, "accuracy": dict(before["accuracy"])}
    del older["accuracy"]["pressure"], older["accuracy"]["viscosity"]
    for values in (before, older):
        assert with_accuracy_of_run(chosen(POOL), values).to_json() == before
    # what the scene names stays, and is then a change
    other = with_accuracy_of_run(chosen(POOL, ["accuracy.pressure=implicit"]), before)
    assert other.accuracy.pressure == "implicit"


def test_an_engine_without_it_runs_the_explicit_one(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text(POOL.replace("0.1\n[mat", "1e-3\nframes = 2\n[mat"))
    argv = [str(path), "--engine", "numpy", "-o", str(tmp_path / "out")]
    assert cli.main(argv) == 0
    (line,) = [s for s in capsys.readouterr().err.splitlines() if "engine numpy" in s]
    assert line.endswith("engine numpy runs this scene with accuracy.pressure = 'explicit'")
    run = vgmpi.run(load(path), None, engine="numpy")
    assert run.code == 0 and run._inner.scene.accuracy.pressure == "explicit"
    with pytest.raises(ValueError, match="no implicit pressure: accuracy.pressure"):
        vgmpi.run(load(path, ("accuracy.pressure=implicit",)), None, engine="numpy")


def test_named_and_chosen_take_the_same_steps(tmp_path):
    found = []
    for text in (POOL, with_accuracy("pressure", "implicit")):
        simulation, _ = begin(tmp_path, text)
        advance(simulation, 0.01)
        found.append(np.concatenate([part.ravel() for part in by_id(simulation, "x", "v")]))
    assert np.array_equal(*found)
