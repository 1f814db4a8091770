"""The board: its measures on made states, its front, its command, and the solver on its cases."""

import json
import subprocess
import sys

import numpy as np
import pytest

from tests.support.launch import ROOT
from vgmpi.tools.bench import __main__ as bench
from vgmpi.tools.bench.board import board_command, board_results
from vgmpi.tools.bench.board.board_cases import (
    BEAM_CLAMP,
    CASES,
    GRAVITY,
    MPS_FRONT,
    BarMeasure,
    BeamMeasure,
    BoardState,
    FrontMeasure,
    LevelMeasure,
    SandMeasure,
    VortexMeasure,
    beam_sag,
    vortex_velocity,
)
from vgmpi.tools.bench.board.board_command import RUNS, draw_board
from vgmpi.tools.bench.board.jet_and_block import BlockMeasure, JetMeasure, jet_velocity
from vgmpi.tools.bench.board.vgmpi_board_solver import Solver


def rows_of(size, spacing, low=(0, 0, 0)):
    """Particles in the middles of cubes that fill a box."""
    axes = [
        start + spacing * (np.arange(round(length / spacing)) + 0.5)
        for start, length in zip(low, size)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


@pytest.mark.parametrize("spacing", [0.146 / 16, 0.146 / 20, 0.146 / 24, 0.146 / 30])
def test_the_front_does_not_depend_on_layers(spacing):
    """Water one eighth of the column's width deep up to the published front, on any lattice."""
    depth = FrontMeasure.DEPTH
    fronts = MPS_FRONT[:, 1] * FrontMeasure.WIDTH
    times = MPS_FRONT[:, 0] * np.sqrt(FrontMeasure.WIDTH / 19.6)
    states = []
    for front in fronts:
        layers = 0.125 * FrontMeasure.WIDTH
        z = np.array([layers / 3, layers * 2 / 3])
        x = np.arange(spacing / 2, front, spacing)
        points = np.stack(np.meshgrid(x, [depth / 2], z, indexing="ij"), -1).reshape(-1, 3)
        states.append((points, np.full(len(points), spacing * depth * layers / 2)))
    errors = []
    for t, (points, volume) in zip(times, states):
        measure = FrontMeasure(volume, points, spacing)
        measure.record(BoardState(t, points, points))
        errors.append(measure.rows[0][1] / FrontMeasure.WIDTH)
    assert np.abs(np.array(errors) - MPS_FRONT[:, 1]).max() < 0.08  # bins are a twelfth
    measure = FrontMeasure(states[0][1], states[0][0], spacing)
    measure.rows = [(t, front) for t, front in zip(times, fronts)]
    assert measure.result()["error"] == pytest.approx(0, abs=1e-12)
    measure.rows = [(t, front + 0.0146) for t, front in zip(times, fronts)]
    assert measure.result()["error"] == pytest.approx(0.1)


def test_the_level_of_flat_water_and_of_water_that_sank():
    x = rows_of((0.32, 0.08, LevelMeasure.LEVEL), 0.01)
    volume = np.full(len(x), 1e-6)
    for factor in (1.0, 0.9):
        measure = LevelMeasure(volume, x, 0.02)
        for t in (0.0, 3.0, 5.0):
            measure.record(BoardState(t, x * [1, 1, factor], 0 * x))
        result = measure.result()
        assert result["level"] == pytest.approx(factor) and result["error"] == pytest.approx(
            1 - factor, abs=1e-9
        )


def test_the_run_out_of_a_wedge():
    """A wedge of 2.2 lengths whose depth falls from one length: 1.2 less what is below 1/40."""
    n = 200_000
    s = (np.arange(n) + 0.5) / n
    length = SandMeasure.LENGTH
    x = np.zeros((n, 3))
    x[:, 0] = 2.2 * length * (1 - np.sqrt(1 - s))
    volume = np.full(n, 1.1 * length * length * SandMeasure.WIDTH / n)
    measure = SandMeasure(volume, x, 0.01)
    measure.record(BoardState(0.6, x, x))
    result = measure.result()
    assert result["run_out"] == pytest.approx(2.2 * (1 - 1 / 40) - 1, abs=0.01)
    assert result["height"] == pytest.approx(1 - 0.005 * 2 / 0.352, abs=0.01)


def test_the_frequency_and_loss_of_a_damped_wave():
    x = rows_of((1.0, 0.1, 0.1), 0.05)
    measure = BarMeasure(np.ones(len(x)), x, 0.05)
    for t in np.arange(0, 2.0001, 1 / 200):
        amplitude = np.exp(-0.1 * t) * np.cos(2 * np.pi * 4.9 * t)
        v = np.outer(amplitude * np.cos(np.pi * (x[:, 0] - x[:, 0].min())), [1, 0, 0])
        measure.record(BoardState(t, x, v))
    result = measure.result()
    assert result["frequency"] == pytest.approx(0.98, abs=2e-3)
    assert result["energy_loss"] == pytest.approx(1 - np.exp(-0.2 / 4.9), rel=0.05)


def test_the_sag_of_a_beam_by_its_moments():
    """Curvature M / (E I) and shear Q / (5/6 G A), integrated from the clamp."""
    x = np.linspace(0, 1, 2001)
    mid, step, load, height = 0.5 * (x[1:] + x[:-1]), x[1], 1000 * 9.8 * 0.125**2, 0.125
    slope = np.cumsum(load * (1 - mid) ** 2 / 2 / (5e7 * height**4 / 12)) * step
    slope -= 0.5 * np.diff(slope, prepend=0)
    shear = load * (1 - mid) / (5 / 6 * 2.5e7 * height**2)
    sag = np.cumsum(slope + shear) * step
    assert beam_sag(x[1:]) == pytest.approx(sag, rel=1e-3, abs=1e-7)
    assert beam_sag(np.array([1.0]))[0] == pytest.approx(0.0190512, rel=1e-5)  # by hand


@pytest.mark.parametrize("period", [0.224, 0.235])
def test_the_deflection_of_a_beam_that_swings(period):
    """About 1.02 of theory, damped a little, with any period, in a clamp that sinks."""
    x = rows_of((1.125, 0.125, 0.125), 0.125 / 8)
    measure = BeamMeasure(np.ones(len(x)), x, 0.03125)
    sag = beam_sag(np.maximum(x[:, 0] - BEAM_CLAMP, 0))
    for t in np.arange(0, 0.6801, 0.01):
        swing = 1.02 * (1 - np.exp(-t) * np.cos(2 * np.pi * t / period))
        measure.record(BoardState(t, x - np.outer(swing * sag + 0.01 * t, [0, 0, 1]), 0 * x))
    result = measure.result()
    assert result["deflection"] == pytest.approx(1.02, abs=6e-3)
    assert result["error"] == pytest.approx(abs(result["deflection"] - 1))


def test_the_beam_of_the_scene_is_that_of_its_case():
    solver, case = Solver("cantilever", {}), CASES["cantilever"]
    solver.restart()
    x, v = solver.state()
    low, high, gap = x.min(axis=0), x.max(axis=0), solver.cell / 4
    assert low == pytest.approx([case.clamp + gap, gap, gap])  # the wall is the clamp
    assert high == pytest.approx(np.array(case.body) - gap) and not v.any()
    material = solver.scene.material["rubber"]
    assert (material.youngs_modulus, material.density) == (case.modulus, 1000)
    assert solver.scene.domain.gravity[2] == -GRAVITY and solver.scene.time.end == case.end
    solver.advance(0.02)  # falls freely at the tip, and is held by the wall
    moved = solver.state()[0][:, 2] - x[:, 2]
    assert moved[x[:, 0] > 0.9 * high[0]].mean() == pytest.approx(-0.5 * GRAVITY * 0.02**2, rel=0.2)
    assert abs(moved[x[:, 0] < low[0] + gap]).max() < 1e-4


def test_vortices_have_no_divergence_and_the_gradient_of_their_velocity():
    x = np.random.default_rng(1).uniform(0, 0.1, (50, 3))
    v, gradient = vortex_velocity(x)
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        difference = (vortex_velocity(x + step)[0] - vortex_velocity(x - step)[0]) / 2e-6
        assert gradient[:, :, k] == pytest.approx(difference, abs=1e-7)
    assert np.trace(gradient, axis1=1, axis2=2) == pytest.approx(0, abs=1e-15)
    walls = vortex_velocity(np.array([[0.0, 0, 0.03], [0.1, 0, 0.02], [0.03, 0, 0.1]]))[0]
    assert [walls[0, 0], walls[1, 0], walls[2, 2]] == pytest.approx([0, 0, 0], abs=1e-15)


def test_the_decay_of_vortices():
    """10 % too fast; what is lost before the first record does not count."""
    x = rows_of((0.1, 0.025, 0.1), 0.003125)
    v = vortex_velocity(x)[0]
    measure = VortexMeasure(np.ones(len(x)), x, 0.00625)
    for k in range(11):
        t = 0.025 * k
        amplitude = (0.9 if k else 1.0) * np.exp(-1.1 * 2 * 1e-3 * (np.pi / 0.1) ** 2 * t)
        measure.record(BoardState(t, x, amplitude * v))
    result = measure.result()
    assert result["decay"] == pytest.approx(1.1) and result["error"] == pytest.approx(0.1)


def test_the_vortices_of_the_scene_are_those_of_their_case():
    solver, case = Solver("vortices", {}), CASES["vortices"]
    solver.restart()
    x, v = solver.state()
    assert solver.volume.sum() == pytest.approx(np.prod(case.body), rel=1e-6)
    assert v == pytest.approx(case.velocity(x)[0], abs=1e-8)
    oil, domain = solver.scene.material["oil"], solver.scene.domain
    assert (oil.viscosity, oil.density, 7 * oil.tait_coefficient) == (
        case.viscosity, 1000, case.bulk_modulus,
    )  # fmt: skip
    assert tuple(domain.size) == case.tank and not any(domain.gravity)


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_the_force_of_a_jet(share):
    """A plate that stops 0.8 of what arrives; impact and end do not count, a ripple is told."""
    x = rows_of(CASES["jet"].body, 0.0125)
    volume = np.full(len(x), 0.0125**3)
    measure = JetMeasure(volume, x, 0.0125)
    for k in range(31):
        t = k / 120
        left = 0.4 - share * t - (0.1 * np.sin(40 * t) if t < 0.14 else 0)
        left += 1e-4 * (-1) ** k if t > 0.14 else 0  # [m] of the column
        measure.record(BoardState(t, x, left / 0.4 * jet_velocity(x)[0]))
    result = measure.result()
    assert result["force"] == pytest.approx(share, abs=2e-3)
    assert result["error"] == pytest.approx(abs(result["force"] - 1))
    assert result["unsteadiness"] == pytest.approx(2e-4 * 120, rel=0.01)


def test_the_jet_of_the_scene_is_that_of_its_case():
    solver, case = Solver("jet", {}), CASES["jet"]
    solver.restart()
    x, v = solver.state()
    gap = solver.cell / 4
    assert x.min(axis=0) == pytest.approx(np.array(case.corner) + gap)
    assert x.max(axis=0) == pytest.approx(np.add(case.corner, case.body) - gap)
    assert v == pytest.approx(case.velocity(x)[0])
    domain = solver.scene.domain
    assert tuple(domain.size) == case.tank and not any(domain.gravity)
    assert solver.scene.time.end == case.end
    assert abs(2 * case.corner[0] + case.body[0] - case.tank[0]) < 1e-12  # in the middle


@pytest.mark.parametrize("draught", [1.0, 0.9])
def test_the_draught_of_a_block_that_bobs(draught):
    """It bobs about its draught with the level, which is right where the water is."""
    edges, corner = CASES["block"].block
    middle = np.array(corner) + np.array(edges) / 2
    boxes = CASES["block"].boxes()
    water = np.concatenate([rows_of(size, 0.005, low) for size, low in boxes])
    measure = BlockMeasure(np.ones(len(water) + 1), np.vstack([water, middle]), 0.01)
    assert measure.block.sum() == 1 and measure.block[-1]
    ends = np.abs(water[:, 0] - 0.12) > 0.06
    low, high = water[ends, 2].min(), water[ends, 2].max()
    for k in range(41):
        t, level = 0.05 * k, BlockMeasure.LEVEL
        x = water.copy()
        x[ends, 2] = (x[ends, 2] - low) / (high - low) * level  # fills the ends up to the level
        bob = 0.3 * np.cos(2 * np.pi * t / 0.45)
        z = level + 0.03 - (draught + bob) * 0.03
        measure.record(BoardState(t, np.vstack([x, [0.12, 0.03, z]]), 0 * middle))
    result = measure.result()
    assert result["draught"] == pytest.approx(draught, abs=3e-3)
    assert result["level"] == pytest.approx(1, abs=1e-3)
    assert result["error"] == pytest.approx(abs(result["draught"] - 1))


def test_the_level_of_a_tank_with_a_block_by_hand():
    """Water of 0.01188 m2 over the depth and half the block, 0.0036 m2, in a tank of 0.24 m."""
    assert BlockMeasure.LEVEL == pytest.approx((0.0198 + 0.0036) / 0.24)
    assert BlockMeasure.DRAUGHT == pytest.approx(0.03)


@pytest.mark.parametrize("options", [{}, {"object.block.rigid": False}])
def test_the_block_of_the_scene_is_that_of_its_case(options):
    solver, case = Solver("block", options), CASES["block"]
    solver.restart()
    x, v = solver.state()
    assert len(x) == len(v) == len(solver.volume) and not v.any()
    water = sum(np.prod(edges) for edges, _ in case.boxes())
    edges, corner = (np.array(row) for row in case.block)
    measure = BlockMeasure(solver.volume, x, solver.cell)
    assert x[measure.block].mean(axis=0) == pytest.approx(corner + edges / 2)
    assert solver.volume[~measure.block].sum() == pytest.approx(water)
    assert solver.volume[measure.block].sum() == pytest.approx(np.prod(edges) if options else 0)
    assert solver.scene.material["wood"].density == 500
    assert tuple(solver.scene.domain.size) == case.tank and solver.scene.time.end == case.end
    solver.advance(0.05)  # it falls at first, half as deep as it floats
    assert solver.state()[0][measure.block, 2].mean() < x[measure.block, 2].mean() - 2e-4


def result_of(solver, cpu, error=None, case="bar", **more):
    result = {
        "case": case, "solver": solver, "options": [], "simulated": 2.0, "cpu": cpu, "wall": cpu,
        "particles": 100, "steps": 10, "same_bits": True, **more,
    }  # fmt: skip
    return result if error is None else result | {"error": error}


def test_the_front_and_the_advantage():
    results = [
        result_of("vgmpi", 1.0, 0.1), result_of("vgmpi", 2.0, 0.05), result_of("newton", 30, 0.2),
        result_of("newton", 8.0, 0.05), result_of("genesis", 0.5, 0.3),
        result_of("genesis", 9.0, 0.01), result_of("vgmpi", 1.0, case="rest"),
        result_of("newton", 4.0, case="rest"),
    ]  # fmt: skip
    marked = board_results.mark_front(results)
    assert [r["on_front"] for r in marked] == [True, True, False, False, True, True, True, False]
    ratios = board_results.advantages(results)
    assert ratios == {
        ("bar", "newton"): 4.0,  # the dearer run is 30 times as dear
        ("bar", "genesis"): 0.0,  # nothing here reaches 1 %
        ("rest", "newton"): 4.0,
    }
    text = board_results.format_tables(marked)
    assert "| bar | genesis | not reached by vgmpi |" in text and "| bar | newton | 4.0 |" in text


def test_errors_below_the_resolution_of_a_reference_are_equal():
    """1e-3 of the bar's frequency: what costs more is not on the front by its smaller error."""
    results = [result_of("vgmpi", 1.0, 0.0009), result_of("genesis", 5.0, 0.0001)]
    assert [r["on_front"] for r in board_results.mark_front(results)] == [True, False]
    assert board_results.advantages(results) == {("bar", "genesis"): 5.0}


def test_runs_on_two_cores_have_a_table_of_their_own():
    """They are compared by wall time with the same run on one core, and with nothing else."""
    one = result_of("genesis", 8.0, 0.1) | {"options": ["cell=1"]}
    two = one | {"options": ["cell=1", "threads=2"], "cpu": 0.1, "wall": 5.0}
    alone = result_of("vgmpi", 0.1, 0.01) | {"options": ["domain.cell=7", "threads=2"]}
    results = [one, result_of("vgmpi", 2.0, 0.1), two, alone]
    marked = board_results.mark_front(results)
    assert [r["on_front"] for r in marked] == [False, True, False, False]
    assert board_results.advantages(results) == {("bar", "genesis"): 4.0}
    assert board_results.pair_cores(results) == [(one, two)]
    text = board_results.format_tables(marked)
    assert "| bar | genesis | cell=1 | 4 | 2.5 | 1.6 |" in text and text.count("threads=2") == 0
    assert board_results.format_csv(marked).count("threads=2") == 2


def test_the_whole_time_of_the_board_is_told():
    results = [result_of("vgmpi", 1.0, 0.1) | {"elapsed": 80.0}, result_of("genesis", 5.0, 0.1)]
    results += [result_of("newton", 5.0, 0.1) | {"elapsed": 100.0}]
    text = board_results.format_tables(board_results.mark_front(results))
    assert text.endswith("2 runs took 3.0 minutes, 1 more were not timed.")
    assert "not timed" not in board_results.format_tables(board_results.mark_front(results[::2]))


def test_a_failed_run_is_a_row():
    results = [
        result_of("vgmpi", 1.0, 0.1),
        {"case": "bar", "solver": "newton", "options": ["dt=1"], "failure": "it flies apart"},
    ]
    text = board_results.format_tables(board_results.mark_front(results))
    assert "| newton | dt=1 | | | | | it flies apart | | |" in text
    assert "it flies apart" in board_results.format_csv(board_results.mark_front(results))


def test_five_cases_are_drawn_in_two_rows(tmp_path):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    names = [name for name, case in CASES.items() if case.resolution]
    heights = []
    for count in (4, 5):
        results = [result_of("vgmpi", 1.0, 0.1, case=name) for name in names[:count]]
        draw_board(tmp_path / "board.png", board_results.mark_front(results))
        heights.append(len(pyplot.imread(tmp_path / "board.png")))
    assert heights[1] == 2 * heights[0]


def test_every_case_has_three_settings_of_each_solver():
    for case, runs in RUNS.items():
        assert CASES[case] and len(set(runs)) == len(runs)
        count = {
            name: sum(run[0] == name for run in runs) for name in ("vgmpi", "newton", "genesis")
        }
        least = 3 if case not in ("rest", "splash") else 1  # nothing to be more exact in
        assert min(count.values()) >= least, (case, count)


def test_the_command(tmp_path, monkeypatch, capsys):
    """Runs that are there are not made again, a torn line is, rivals that are absent are named."""
    monkeypatch.setitem(RUNS, "bar", (("vgmpi", "domain.cell=0.1"), ("vgmpi", "domain.cell=7")))
    out = tmp_path / "board"
    argv = ["board", "--only", "bar", "-o", str(out)]
    assert bench.main(argv) == 1  # one of its runs fails
    text = capsys.readouterr()
    assert "newton is not installed in" in text.err and "left out (--setup)" in text.err
    assert "bar: vgmpi domain.cell=0.1" in text.err
    first = board_results.read_results(out / "results.jsonl")
    good, bad = first
    assert good["error"] < 0.02 and good["same_bits"] and good["particles"] == 320
    assert "domain" in bad["failure"] and bad["options"] == ["domain.cell=7"]
    assert (out / "board.csv").read_text().count("\n") == 3 and "on_front" not in good
    monkeypatch.setattr(board_command, "make_run", lambda *words: pytest.fail("made again"))
    assert bench.main(argv) == 1
    with open(out / "results.jsonl", "w") as file:
        file.write(json.dumps(good)[:40])
    monkeypatch.setattr(board_command, "make_run", lambda *words: good)
    assert bench.main(argv) == 0


def test_the_rivals_cannot_be_installed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(board_command, "RIVAL_PACKAGES", ("no-such-package-of-anybody==1",))
    monkeypatch.setattr(
        board_command.subprocess, "run", lambda *a, **k: subprocess.CompletedProcess(a, 1)
    )
    monkeypatch.setattr(board_command.venv, "create", lambda *a, **k: None)
    assert bench.main(["board", "--setup", "-o", str(tmp_path)]) == 1
    assert "the rivals cannot be installed: pip's lines say why" in capsys.readouterr().err


def test_measures_need_numpy_alone():
    """They run in the environments of the rivals."""
    code = (
        "import sys; import vgmpi.tools.bench.board.board_run as b; "
        "print([m for m in ('numba', 'pydantic', 'h5py', 'mpi4py', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert done.stdout.strip() == "[]"
