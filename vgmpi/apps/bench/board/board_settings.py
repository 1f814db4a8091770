"""Runs of the board: three settings or more of every solver on every case.

Settings of the rivals are those of their own examples, and the best ones that were found: smaller
cells, smaller or larger steps, more stiffness.
"""

# packages of the rivals' environment
RIVAL_PACKAGES = ("newton==1.8.0", "warp-lang==1.19.0", "torch", "genesis-world==1.4.5")

STEP_120, STEP_240, STEP_480 = "dt=0.00833333333", "dt=0.00416666667", "dt=0.00208333333"
SOFT, LONG_STEPS = "material.water.compression=0.04", "time.cfl=1.0"
STIFF_STEP = "step_per_cell=0.004"  # [s/m] of 5e7 Pa: a wave crosses 0.9 of a cell
APIC = "accuracy.transfer=apic"
IMPLICIT = "accuracy.pressure=implicit"
S2 = "collider_basis=S2"  # Newton's default; its example of a dam break has pic
DAM_CELLS_48 = 0.146 * 4 / 48  # [m]

RUNS: dict[str, tuple[tuple[str, ...], ...]] = {
    "dam_break": (
        ("vgmpi", "accuracy.level=draft", LONG_STEPS),
        ("vgmpi", "accuracy.level=draft"),
        ("vgmpi", f"domain.cell={DAM_CELLS_48}", SOFT),
        ("vgmpi", f"domain.cell={DAM_CELLS_48}"),
        ("vgmpi",),
        ("vgmpi", "accuracy.level=draft", IMPLICIT),
        ("vgmpi", f"domain.cell={DAM_CELLS_48}", IMPLICIT),
        ("vgmpi", IMPLICIT),
        ("newton", "cell=0.01825", STEP_120),
        ("newton", f"cell={DAM_CELLS_48}", STEP_240),
        ("newton", f"cell={DAM_CELLS_48}", STEP_480),
        ("genesis", "cell=0.01825"),
        ("genesis", "cell=0.01825", "step_per_cell=0.04"),
        ("genesis", f"cell={DAM_CELLS_48}", "E=2.25e6"),
        ("genesis", "cell=0.009125"),
    ),
    "level": (
        ("vgmpi", SOFT, "time.cfl=0.6"),  # 1.0 is unstable
        ("vgmpi", SOFT),
        ("vgmpi", "domain.cell=0.016"),
        ("vgmpi",),
        ("vgmpi", "domain.cell=0.013333333333333334"),
        ("vgmpi", IMPLICIT),
        ("vgmpi", "domain.cell=0.013333333333333334", IMPLICIT),
        ("newton", "cell=0.04", STEP_120),
        ("newton", "cell=0.04", "dt=0.00238095238"),
        ("newton", "cell=0.02", STEP_120),
        ("genesis", "cell=0.02", "particle_size=0.64", "sampler=pbs"),
        ("genesis", "cell=0.02"),
        ("genesis", "cell=0.013333333333333334"),
    ),
    "sand": (
        ("vgmpi", "domain.cell=0.02"),
        ("vgmpi", "domain.cell=0.013333333333333334"),
        ("vgmpi",),
        ("newton", "cell=0.02", "dt=0.0166666667"),
        ("newton", "cell=0.013333333333333334", "dt=0.0166666667"),
        ("newton", "cell=0.013333333333333334", STEP_240),
        ("genesis", "cell=0.02", "E=5e5"),
        ("genesis", "cell=0.02"),
        ("genesis", "cell=0.013333333333333334"),
    ),
    "bar": (
        ("vgmpi", "domain.cell=0.1"),
        ("vgmpi",),
        ("vgmpi", "domain.cell=0.025"),
        ("newton", "cell=0.1", STEP_240, "end=0.6"),
        ("newton", "cell=0.05", STEP_240, "end=0.6"),
        ("newton", "cell=0.1", "dt=0.001", "end=0.6"),
        ("genesis", "cell=0.1"),
        ("genesis", "cell=0.05"),
        ("genesis", "cell=0.033333333333333333"),
    ),
    "cantilever": (
        ("vgmpi", "domain.cell=0.0625", LONG_STEPS, APIC),
        ("vgmpi", "domain.cell=0.0625", LONG_STEPS),
        ("vgmpi", "domain.cell=0.0625"),
        ("vgmpi", "domain.cell=0.041666666666666664"),
        ("vgmpi",),
        ("vgmpi", "domain.cell=0.020833333333333333"),
        ("newton", "cell=0.0625", "dt=0.01", "end=0.45"),
        ("newton", "cell=0.0625", "dt=0.0025", "end=0.45"),
        ("newton", "cell=0.0625", "dt=0.0025", "end=0.45", "per_axis=3"),
        ("genesis", "cell=0.0625", STIFF_STEP),
        ("genesis", "cell=0.041666666666666664", STIFF_STEP),
        ("genesis", "cell=0.03125", STIFF_STEP),
        ("genesis", "cell=0.020833333333333333", STIFF_STEP),
    ),
    "vortices": (
        ("vgmpi", IMPLICIT),
        ("vgmpi",),
        ("vgmpi", "domain.cell=0.005"),
        ("vgmpi", "domain.cell=0.0041666666666666666", IMPLICIT),
        ("vgmpi", "domain.cell=0.0041666666666666666"),
        ("newton", "cell=0.00625", "dt=0.025"),
        ("newton", "cell=0.00625", STEP_120),
        ("newton", "cell=0.0041666666666666666", STEP_120),
        ("genesis", "cell=0.00625", "step_per_cell=0.2"),
        ("genesis", "cell=0.00625", "step_per_cell=0.4"),
        ("genesis", "cell=0.0041666666666666666", "step_per_cell=0.4"),
        ("genesis", "cell=0.003125", "step_per_cell=0.4"),
    ),
    "jet": (
        ("vgmpi", "domain.cell=0.025", IMPLICIT),
        ("vgmpi", "domain.cell=0.025"),
        ("vgmpi", IMPLICIT),
        ("vgmpi", SOFT),
        ("vgmpi",),
        ("vgmpi", "domain.cell=0.00625", IMPLICIT),
        ("vgmpi", "domain.cell=0.00625"),
        ("newton", "cell=0.025", STEP_120),
        ("newton", "cell=0.0125", STEP_120),
        ("newton", "cell=0.0125", STEP_120, S2),
        ("newton", "cell=0.0125", STEP_240),
        ("newton", "cell=0.00625", STEP_120),
        ("genesis", "cell=0.025"),
        ("genesis", "cell=0.0125"),
        ("genesis", "cell=0.00625"),
    ),
    "block": (
        ("vgmpi", "domain.cell=0.015", SOFT),
        ("vgmpi", "domain.cell=0.015"),
        ("vgmpi",),
        ("vgmpi", "object.block.rigid=false"),
        ("newton", "cell=0.015", STEP_120),
        ("newton", "cell=0.015", STEP_120, S2),
        ("newton", "cell=0.015", STEP_240),
        ("newton", "cell=0.01", STEP_120),
        ("genesis", "cell=0.02"),
        ("genesis", "cell=0.015"),
        ("genesis", "cell=0.01"),
    ),
    "rest": (
        ("vgmpi", LONG_STEPS),
        ("vgmpi",),
        ("vgmpi", IMPLICIT),
        ("newton", "cell=0.016", STEP_120),
        ("newton", "cell=0.01", STEP_120, "per_axis=2"),
        ("genesis", "cell=0.01"),
    ),
    "splash": (
        ("vgmpi", SOFT, LONG_STEPS),
        ("vgmpi", SOFT),
        ("vgmpi",),
        ("vgmpi", IMPLICIT),
        ("newton", "cell=0.016", "dt=0.0166666667"),
        ("newton", "cell=0.016", STEP_120),
        ("newton", "cell=0.01", STEP_120, "per_axis=2"),
        ("genesis", "cell=0.01", "end=0.1"),
    ),
}
