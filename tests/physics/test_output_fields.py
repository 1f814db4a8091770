"""Stress and pressure in the files of a run, as ParaView's reader reads them: matter at rest.

Theory: p = rho g d at a depth d in a pool, with an isotropic stress; -sigma_zz = rho g d in a bar
of Poisson's ratio 0 that stands on a frictionless floor, with no other stress. d is the depth at
rest: weight above. Tolerance: 2 % of rho g d below the uppermost cell. A bar's particles are taken
by layers of cells: within a cell, their stress is off the mean by as much as a tenth of the weight
of a cell, up and down.
"""

import numpy as np
import pytest
import pyvista
from vtkmodules.vtkIOHDF import vtkHDFReader

import vgmpi
from tests.support.validation_record import held

H, CELL, RHO, G = 0.16, 0.01, 1000.0, 9.8
POOL = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.04, 0.04, 0.2]
cell = 0.01
gravity = [0, 0, -9.8]
[time]
end = 0.5
frames = 3
[material.water]
kind = "fluid"
density = 1000
max_depth = 0.16
max_compression = 0.0015
[[object]]
name = "water"
material = "water"
initial_pressure = "hydrostatic"
shape = { box = [[0, 0, 0], [0.04, 0.04, 0.16]] }
[output]
fields = ["stress", "pressure", "strain"]
"""
BAR = """
[domain]
size = [0.12, 0.12, 0.2]
cell = 0.01
gravity = [0, 0, -9.8]
gravity_ramp_time = 0.5
[accuracy]
pressure = "explicit"
transfer = "apic"
[time]
end = 1
frames = 3
[material.rod]
kind = "elastic"
density = 1000
youngs_modulus = 2e5
poisson_ratio = 0.0
[[object]]
name = "bar"
material = "rod"
shape = { box = [[0.04, 0.04, 0], [0.08, 0.08, 0.16]] }
[output]
fields = ["stress", "pressure", "strain"]
"""


def first_and_last(folder, text):
    """The first and the last frame of a run's series, by VTK's reader."""
    scene = vgmpi.load(folder / "scene.toml", text=text)
    assert vgmpi.run(scene, folder / "out").code == 0
    reader = vtkHDFReader()
    reader.SetFileName(str(folder / "out" / "series.vtkhdf"))
    reader.UpdateInformation()
    meshes = []
    for step in (0, reader.GetNumberOfSteps() - 1):
        reader.SetStep(step)
        reader.Update()
        meshes.append(pyvista.wrap(reader.GetOutput()).copy())
    assert np.array_equal(meshes[0].point_data["id"], meshes[1].point_data["id"])
    return meshes


def test_a_pool_at_rest(tmp_path):
    first, last = first_and_last(tmp_path, POOL)
    depth = H - first.points[:, 2]
    inner = depth > CELL
    stress, pressure = last.point_data["stress"], last.point_data["pressure"]
    assert stress.shape == (len(depth), 6) and pressure.shape == depth.shape
    want = RHO * G * depth
    errors = np.abs(pressure / want - 1)[inner]
    say = {"kind": "below", "unit": "of rho g d", "source": "p = rho g d"}
    held("pool at rest: pressure field", float(errors.max()), 0.0, 0.02, **say)
    for axis in range(3):
        assert np.abs(-stress[inner, axis] / want[inner] - 1).max() < 0.02
    assert np.abs(stress[:, 3:]).max() < 1e-3 * RHO * G * H
    # compression of a liquid, from K = rho g H / 0.15 %
    bulk = RHO * G * H / 0.0015
    strain = last.point_data["strain"][:, :3].sum(1)
    assert strain[inner] == pytest.approx(-want[inner] / bulk, rel=0.03)


def test_an_elastic_bar_under_its_own_weight(tmp_path):
    first, last = first_and_last(tmp_path, BAR)
    depth = H - first.points[:, 2]
    stress = -last.point_data["stress"] / (RHO * G)  # in meters of depth
    layer = np.floor(depth / CELL).astype(int)
    count = np.bincount(layer)
    mean = np.bincount(layer, stress[:, 2]) / count
    want = np.bincount(layer, depth) / count
    errors = np.abs(mean / want - 1)[1:]
    say = {"kind": "below", "unit": "of rho g d", "source": "sigma_zz = -rho g d"}
    held("bar under its weight: stress field", float(errors.max()), 0.0, 0.02, **say)
    assert np.abs(stress[:, 2] - depth)[layer > 0].max() < 0.25 * CELL
    assert np.abs(stress[:, [0, 1, 3, 4, 5]]).max() < 1e-3 * H
    assert last.point_data["pressure"] == pytest.approx(RHO * G * stress[:, 2] / 3, rel=1e-4)
    # sigma = mu (s^2 - 1) / s of the neo-Hookean bar with nu = 0, mu = E / 2; strain = ln s
    s = np.exp(last.point_data["strain"][:, 2])
    sigma = -0.5 * 2e5 * (s * s - 1) / s / (RHO * G)
    assert sigma == pytest.approx(stress[:, 2], rel=1e-3, abs=1e-3 * CELL)
