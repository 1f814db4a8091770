"""Stress and strain of output files, against derivatives of the energy and the motion itself."""

import numpy as np
import pytest

from tests.materials.test_laws import (
    CASES,
    SAMPLES,
    deformations,
    energy,
    full,
    of_deformation,
    stiffness,
)
from vgmpi.materials import continuum_fields, registry
from vgmpi.materials.material import law_function

STILL = np.zeros((9, 1))
# keys with which the laws yield in the motion below
YIELDS = {
    "sand": {"cohesion": 2000.0},
    "metal": {"youngs_modulus": 2e6, "yield_stress": 5e3},
    "paste": {"preset": "ketchup", "shear_modulus": 3e3},
    "foam": {"preset": "shaving foam"},
    "plasticine": {"youngs_modulus": 1e5, "yield_stress": 1e3},
}


@pytest.fixture(params=CASES, ids=[f"{kind}-{k}" for kind, k in CASES])
def material(request):
    kind, k = request.param
    return registry[kind](kind=kind, **SAMPLES[kind][k])


def state_of(material, F):
    """The state by name of one particle with the deformation gradient F."""
    told = of_deformation(material, F)
    rows = {name: told.get(name, rest) for name, rest in material.carries.items()}
    return {name: np.array(values)[:, None] for name, values in rows.items()}


def full_of(row):
    """The tensor of a row in the order of VTK: xx, yy, zz, xy, yz, xz."""
    xx, yy, zz, xy, yz, xz = row
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_cauchy_stress_is_the_work_per_present_volume(material):
    """det(F) sigma : D = d psi along a velocity gradient D, by central differences."""
    h = 1e-6
    for F in deformations(10):
        row = continuum_fields.cauchy_stress(material.law(), state_of(material, F), STILL)
        sigma = np.linalg.det(F) * full_of(row[0])
        assert np.array_equal(sigma, sigma.T)
        for a, b in np.ndindex(3, 3):
            E = np.zeros((3, 3))
            E[a, b] = h
            up, down = (energy(material, (np.eye(3) + s * E) @ F) for s in (1, -1))
            bound = 2e-8 * stiffness(material)
            assert (up - down) / (2 * h) == pytest.approx(sigma[a, b], abs=bound, rel=2e-8)


def test_pressure_is_minus_a_third_of_the_trace():
    stress = np.array([[-1.0, -2.0, -6.0, 5.0, 7.0, 9.0], [3.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    assert continuum_fields.mean_pressure(stress).tolist() == [3.0, -1.0]


def test_strain_is_half_the_logarithm_of_b(material):
    """By eigenvalues of NumPy; a liquid that holds no shape has the isotropic part alone."""
    for F in deformations(10):
        row = continuum_fields.logarithmic_strain(material.law(), state_of(material, F))[0]
        d, q = np.linalg.eigh(F @ F.T)
        want = q @ np.diag(0.5 * np.log(d)) @ q.T
        if set(material.carries) == {"theta"}:
            want = np.eye(3) * np.log(np.linalg.det(F)) / 3
        np.testing.assert_allclose(full_of(row), want, atol=1e-9)


def test_a_state_without_shape_has_the_strain_of_its_volume(monkeypatch):
    """A law may name its state as it likes."""
    material = registry["fluid"](kind="fluid")
    state = {"bulk": np.array([[0.3]])}
    row = continuum_fields.logarithmic_strain(material.law(), state)[0]
    np.testing.assert_allclose(row, [0.1, 0.1, 0.1, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize("kind", registry)
def test_the_volume_is_that_of_the_motion(kind):
    """Kirchhoff stress over Cauchy stress is the determinant of all that a particle went through,
    also where the law yields: compression, shear, expansion and compression again.
    """
    material = registry[kind](kind=kind, **YIELDS.get(kind, SAMPLES[kind][0]))
    law, dt = material.law(), 1e-4
    state = tuple(v for values in material.carries.values() for v in values)
    F, ratios = np.eye(3), []
    shear = np.array([[0.0, 3.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    for rate, steps in ((-1.0, 1500), (1.0, 2500), (-1.0, 2000)):
        L = rate * np.diag([0.5, 0.2, 0.6]) + shear
        for _ in range(steps):
            state = law_function(law, "advance")(law, state, tuple(L.flat), dt)
            F = (np.eye(3) + dt * L) @ F
        names, first = {}, 0
        for name, rest in material.carries.items():
            names[name] = np.array(state[first : first + len(rest)])[:, None]
            first += len(rest)
        tau = full(law_function(law, "stress")(law, state, tuple(STILL[:, 0])))
        sigma = full_of(continuum_fields.cauchy_stress(law, names, STILL)[0])
        size = np.abs(tau).max()
        if size > 1e-6 * law_function(law, "wave_speed2")(law, state):  # what is open bears none
            np.testing.assert_allclose(np.linalg.det(F) * sigma, tau, atol=2e-3 * size)
            ratios.append(np.linalg.det(F))
    assert len(ratios) >= 2 and abs(ratios[0] - 1) > 0.1
