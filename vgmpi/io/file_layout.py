"""Name, shape, type, unit and meaning of every dataset of every file: the single source.

`python -m vgmpi.io.layout_reference > docs/reference/file-format.md` writes the page for users.
"""

import re
from typing import NamedTuple

import numpy as np

SCHEMA = 2  # of all files; files of another schema are refused

FRAMES, CHECKPOINTS = "frames", "checkpoints"  # folders inside the output folder
LOCK = "run.lock"  # lock file of the run that writes into the folder
BLOWUP = "blowup"  # folder of the state in which a run diverged
SERIES, GAUSSIANS, LEDGER = "series.vtkhdf", "gaussians.h5", "ledger.csv"
PROBE_NAME = "probe_{}.csv"
FRAME_NAME = "frame_{:05d}.vtkhdf"
MAX_FRAMES = 1_000_000  # upper bound of the number of frames
CHECKPOINT_NAME = "checkpoint_{:09d}.h5"  # the manifest has this name with the ending .json
CRC = "crc"  # name of the dataset or column with the checksums of the others
CRC_ROWS = 1 << 16  # rows per checksum in a manifest


class Dataset(NamedTuple):
    """Description of one dataset; `shape` as on the page, `dtype` NumPy short names joined by |."""

    name: str
    shape: str
    dtype: str
    unit: str
    meaning: str


def axis_columns(name: str, unit: str, meaning: str, axes: str = "xyz") -> list[Dataset]:
    """Return a column of a CSV table for each component of a vector.

    Args:
        name: Name of the vector.
        unit: Unit.
        meaning: Meaning, the same for all components.
        axes: Letter of each component.
    """
    return [Dataset(f"{name}_{axis}", "", "f8", unit, meaning) for axis in axes]


def frame_number(name: str) -> int | None:
    """Return the number of the frame with this file name; None for other names."""
    match = re.fullmatch(r"frame_([0-9]{5,6})\.vtkhdf", name)
    number = int(match[1]) if match else -1
    return number if FRAME_NAME.format(number) == name else None


def row_shape(dataset: Dataset) -> tuple[int | None, ...]:
    """Return the shape of one row, None for any length: "(n, K, 3)" -> (None, 3)."""
    words = [w.strip() for w in dataset.shape.strip("()").split(",") if w.strip()]
    return tuple(int(w) if w.isdigit() else None for w in words[1:])


def fits(dataset: Dataset, array: np.ndarray) -> bool:
    """Return True if the rows of an array have the dataset's shape and type."""
    want = row_shape(dataset)
    have = array.shape[1:]
    return (
        len(want) == len(have)
        and all(w is None or w == h for w, h in zip(want, have))
        and array.dtype.str[1:] in dataset.dtype.split("|")
    )


def named(datasets: list[Dataset]) -> dict[str, Dataset]:
    """Return the datasets by their names."""
    return {d.name: d for d in datasets}


# ---- frames/frame_00000.vtkhdf ----------------------------------------------------------------
# In the file, positions is /VTKHDF/Points and the others are in /VTKHDF/PointData.
FRAME = [
    Dataset("id", "(n,)", "i8", "1", "particle number, ascending; its row in gaussians.h5"),
    Dataset("positions", "(n, 3)", "f4", "m", "position in the domain"),
    Dataset("velocity", "(n, 3)", "f4", "m/s", "velocity"),
    Dataset("J", "(n,)", "f4", "1", "volume ratio; its elastic part in plastic materials"),
    Dataset("F", "(n, 9)", "f4", "1", "deformation gradient, row by row; cbrt(J) I without one"),
    Dataset("stress", "(n, 6)", "f4", "Pa", "Cauchy stress of the material's law, tension positive:"
            " xx, yy, zz, xy, yz, xz (VTK's order); of a liquid in pores its own, of sand with a"
            " liquid the effective stress; only on request"),
    Dataset("pressure", "(n,)", "f4", "Pa", "minus a third of the trace of `stress`; only on"
            " request"),
    Dataset("strain", "(n, 6)", "f4", "1", "logarithmic strain ln(b) / 2 in the same order, b = F"
            " F^T; its elastic part in plastic materials, ln(J) / 3 I in liquids: its trace is"
            " ln J; only on request"),
    Dataset("volume_fraction", "(n,)", "f4", "1", "fraction of the space of the mixture that the"
            " particle's phase fills; 1 in phases that share no space; only on request"),
    Dataset("color_sh", "(n, 3 K)", "f4", "1", "color as `sh` of gaussians.h5, coefficient by"
            " coefficient; nan without color transfer; only with appearance.color_transfer = step"),
    Dataset("object", "(n,)", "i4", "1", "number of the object in the list `objects`"),
    Dataset("phase", "(n,)", "i4", "1", "number of the velocity field it moves with"),
]  # fmt: skip
FRAME_FIELD_DATA = [
    Dataset("time", "(1,)", "f8", "s", "simulated time"),
    Dataset("step", "(1,)", "i8", "1", "number of time steps made"),
]
FRAME_TOPOLOGY = [
    Dataset("NumberOfPoints", "(1,)", "i8", "1", "n"),
    Dataset("Vertices/NumberOfCells", "(1,)", "i8", "1", "n: a vertex per particle"),
    Dataset("Vertices/NumberOfConnectivityIds", "(1,)", "i8", "1", "n"),
    Dataset("Vertices/Connectivity", "(n,)", "i4|i8", "1", "0, 1, ... n - 1"),
    Dataset("Vertices/Offsets", "(n + 1,)", "i4|i8", "1", "0, 1, ... n"),
    Dataset("Lines/*", "(0 or 1,)", "i8", "1", "empty; required by VTK (also Polygons, Strips)"),
]
CHECKSUMS = Dataset(CRC, "()", "text", "", "JSON, CRC32 (zlib) of the bytes of every other dataset")
FRAME_OWN = [
    Dataset("frame", "()", "i8", "1", "number of the frame, as in the name of its file"),
    Dataset("gaussians_crc", "()", "u4", "1", "checksum that identifies the matching gaussians.h5"),
    Dataset(
        "poses",
        "(m, 4, 4)",
        "f8",
        "m",
        "pose of each object with `is_moving`, in their order: initial -> current position; only if"
        " one moves",
    ),
    CHECKSUMS,
]

# ---- series.vtkhdf ----------------------------------------------------------------------------
SERIES_STEPS = [
    Dataset("Steps/Values", "(frames,)", "f8", "s", "simulated time of each frame"),
    Dataset("Steps/PartOffsets", "(frames,)", "i8", "1", "0, 1, 2, ...: one part per frame"),
    Dataset("Steps/NumberOfParts", "(frames,)", "i8", "1", "1"),
    Dataset("Steps/PointOffsets", "(frames,)", "i8", "1", "first row of each frame"),
    Dataset("Steps/CellOffsets", "(frames, 4)", "i8", "1", "the same for the vertices"),
    Dataset("Steps/ConnectivityIdOffsets", "(frames, 4)", "i8", "1", "the same"),
    Dataset("Steps/PointDataOffsets/*", "(frames,)", "i8", "1", "the same, for each array"),
    Dataset("Steps/FieldDataOffsets/*", "(frames,)", "i8", "1", "row of each frame's value"),
    Dataset("Steps/FieldDataSizes/*", "(frames, 2)", "i8", "1", "1 component, 1 row"),
]
SERIES_OWN = [
    Dataset("frames", "(frames,)", "i8", "1", "numbers of the frames"),
    CHECKSUMS._replace(meaning="as in a frame, of the datasets that are not virtual"),
]

# ---- gaussians.h5 -----------------------------------------------------------------------------
GAUSSIAN = [
    Dataset("x0", "(n, 3)", "f8", "m", "initial position in the domain; at the mouth of an inlet"),
    Dataset("vol0", "(n,)", "f8", "m3", "rest volume"),
    Dataset("object", "(n,)", "i4", "1", "number of the object in the list `objects`"),
    Dataset("v0", "(n, 3)", "f8", "m/s", "initial velocity, or velocity at the mouth of an inlet;"
            " only if one is not 0"),
    Dataset("theta0", "(n,)", "f8", "1", "initial ln J; only if one is not 0"),
    Dataset("surface0", "(n, 10)", "f4", "1, m, 1/m", "surface of a solid at rest: outward normal,"
            " whose length is its confidence, signed distance (negative inside), and the gradient"
            " of the normal xx, xy, xz, yy, yz, zz; only if a solid may touch something"),
    Dataset("cov0", "(n, 6)", "f4", "m2", "rest covariance: xx, xy, xz, yy, yz, zz"),
    Dataset("opacity", "(n,)", "f4", "1", "0 to 1"),
    Dataset("sh", "(n, K, 3)", "f4", "1", "spherical harmonics of the color, K = 1, 4, 9 or 16"),
    Dataset("shade", "(n,)", "f4", "1", "factor, 0.001 to 1, by which `appearance.baked_shading`"
            " darkened the color; (0.5 + 0.2820948 sh[:, 0]) / shade is the color without that"
            " light; after pruning, the mean of the merged Gaussians; only if one is not 1"),
]  # fmt: skip
OPTIONAL = ("v0", "theta0", "surface0", "shade")  # datasets that some files lack, also in groups
SHADE = Dataset("shade", "(m,)", "f4", "1", "as above; only if one is not 1")
SCENERY = [
    Dataset(
        "x0", "(m, 3)", "f8", "m", "initial position; constant unless its object has `is_moving`"
    ),
    Dataset("object", "(m,)", "i4", "1", "number of the object in the list `objects`"),
    Dataset("cov0", "(m, 6)", "f4", "m2", "covariance: xx, xy, xz, yy, yz, zz"),
    Dataset("opacity", "(m,)", "f4", "1", "0 to 1"),
    Dataset("sh", "(m, K, 3)", "f4", "1", "spherical harmonics of the color"),
    SHADE,
]
PASSIVE = [
    Dataset("x0", "(p, 3)", "f8", "m", "position at rest"),
    Dataset("object", "(p,)", "i4", "1", "number of the object in the list `objects`"),
    Dataset("cov0", "(p, 6)", "f4", "m2", "rest covariance: xx, xy, xz, yy, yz, zz"),
    Dataset("opacity", "(p,)", "f4", "1", "0 to 1"),
    Dataset("sh", "(p, K, 3)", "f4", "1", "spherical harmonics of the color"),
    Dataset("carriers", "(p, 4)", "i8", "1", "numbers of the particles that it follows"),
    Dataset("weights", "(p, 4)", "f4", "1", "their weights, with the sum 1"),
    SHADE._replace(shape="(p,)"),
]
GAUSSIAN_TEXTS = [
    Dataset(
        "objects",
        "()",
        "text",
        "",
        "JSON, an entry per object, then per inlet: name, role, material, kind, family, "
        "tracks_deformation (whether F of the frames is that of its particles), phase, "
        "color_group (objects with the same number exchange colors), "
        "bulk density [kg/m3], first_row and row_count, opacity_scale, alpha_min, "
        "color, collider, is_moving (frames contain the `poses` of these objects), "
        "render_model (antialiased or mip, only for captures trained so: opacities are compensated "
        "for the 0.3 or 0.1 pixels^2 that a renderer adds), "
        "regions (parts of another material: its name, density, first_row and row_count), "
        "and transform (4 x 4, source coordinates -> domain coordinates [m])",
    ),
    Dataset("scene", "()", "text", "", "JSON, the scene with all defaults, in SI units"),
    CHECKSUMS,
]

# ---- checkpoints/checkpoint_000000000.h5 ------------------------------------------------------
# A group is one phase of one material: group_000, group_001, ... in the order of their names. Its
# rows are in the order of the last sort, which is state: block along the Hilbert curve, cell, id.
CHECKPOINT = [
    Dataset("*/block", "(b,)", "i8", "1", "number of each block with particles of the group"),
    Dataset("*/count", "(b,)", "i8", "1", "particles in each of these blocks"),
    Dataset("*/id", "(n,)", "i8", "1", "particle number, its row in gaussians.h5"),
    Dataset(
        "*/x",
        "(n, 3)",
        "i4|i8|f4|f8",
        "2^-29|2^-52 cell",
        "position relative to the center of the block, fixed-point (single|double precision)",
    ),
    Dataset("*/v", "(n, 3)", "f4|f8", "m/s", "velocity"),
    Dataset("*/C", "(n, 9)", "f4|f8", "1/s", "APIC affine velocity, row by row"),
    Dataset("*/vol0", "(n, 1)", "f4|f8", "m3", "rest volume"),
    Dataset(
        "*/state",
        "(n, *)",
        "f4|f8",
        "1",
        "state of the constitutive model: theta = ln J of fluids, F - I of elastic solids; "
        "b_e - I (00, 11, 22, 01, 02, 12) and a history variable of plastic materials; then the "
        "volume fraction in pores, and F - I of bodies whose model does not contain it",
    ),
]
CHECKPOINT_TEXTS = [
    Dataset(
        "attrs",
        "()",
        "text",
        "",
        "JSON: schema, step, time [s], the scene's text and resolved form, versions of the program "
        "and its libraries, and all other data for a bitwise identical restart",
    ),
]

# ---- ledger.csv -------------------------------------------------------------------------------
LEDGER_COLUMNS = [
    Dataset("time", "", "f8", "s", "simulated time"),
    Dataset("step", "", "i8", "1", "number of time steps made"),
    Dataset("phase", "", "text", "", "name of the phase"),
    Dataset("particles", "", "i8", "1", "number of particles"),
    Dataset("mass", "", "f8", "kg", "mass"),
    *axis_columns("momentum", "kg m/s", "momentum"),
    *axis_columns("angular_momentum", "kg m2/s", "angular momentum about the origin"),
    Dataset("kinetic_energy", "", "f8", "J", "kinetic energy, including the affine motion of APIC"),
    Dataset("elastic_energy", "", "f8", "J", "elastic energy"),
    Dataset("potential_energy", "", "f8", "J", "potential energy in gravity"),
    Dataset("J_min", "", "f8", "1", "smallest volume ratio, as in the frames"),
    Dataset("J_max", "", "f8", "1", "largest volume ratio, as in the frames"),
]
OPEN_SYSTEM_COLUMNS = [  # present with inlets or outlets
    Dataset("particles_in", "", "i8", "1", "initial particles and those that entered since"),
    Dataset("mass_in", "", "f8", "kg", "their mass"),
    Dataset("particles_out", "", "i8", "1", "particles that left through outlets"),
    Dataset("mass_out", "", "f8", "kg", "their mass"),
]
LIQUID_COLUMNS = [  # present with liquids; nan for phases that hold anything else or share space
    Dataset("fullest_cell", "", "f8", "1", "largest rest volume in the cell of a node, over what "
            "fits into it"),
    Dataset("filled_volume", "", "f8", "m3", "rest volume, without what does not fit into its "
            "cells"),
]  # fmt: skip

RIGID_COLUMNS = [  # present with free rigid bodies; 0 in all rows of a time but the first
    *axis_columns("rigid_momentum", "kg m/s", "their momentum"),
    *axis_columns("rigid_angular_momentum", "kg m2/s", "their angular momentum about the origin"),
    Dataset("rigid_kinetic_energy", "", "f8", "J", "their kinetic energy"),
    Dataset("rigid_potential_energy", "", "f8", "J", "their potential energy in gravity"),
]

ROW_CHECKSUM = Dataset(
    CRC,
    "",
    "i8",
    "1",
    "CRC32 (zlib) of the preceding text of the row, continued from the row above",
)

# ---- probe_NAME.csv ---------------------------------------------------------------------------
SAMPLE_COLUMNS = LEDGER_COLUMNS[:2]  # first columns of every probe
SINCE = "since the previous row; nan in the first row"
IN_LAST_STEP = "in the last step; nan at the start"
_BODY = [
    *SAMPLE_COLUMNS,
    Dataset("mass", "", "f8", "kg", "mass"),
    *axis_columns("center", "m", "center of mass"),
    *axis_columns("velocity", "m/s", "mean velocity"),
    *axis_columns("momentum", "kg m/s", "momentum"),
    *axis_columns("force", "N", f"mean force, without its weight, {SINCE}"),
]
_REACTION = [
    *SAMPLE_COLUMNS,
    *axis_columns("force", "N", f"mean force of the bodies on it {SINCE}"),
    *axis_columns("torque", "N m", f"mean torque {SINCE}"),
    *axis_columns("impulse", "N s", "time integral of the force"),
    *axis_columns("angular_impulse", "N m s", "time integral of the torque"),
]
PROBE_COLUMNS = {
    "pressure": [
        *SAMPLE_COLUMNS,
        Dataset("pressure", "", "f8", "Pa", "mean of the nearby fluids; nan without fluid"),
    ],
    "surface_height": [
        *SAMPLE_COLUMNS,
        Dataset("surface_height", "", "f8", "m", "height of the surface; 0 without fluid"),
    ],
    "velocity": [
        *SAMPLE_COLUMNS,
        *axis_columns("velocity", "m/s", "mean velocity; nan without particles"),
    ],
    "object": _BODY,
    "rigid body": [
        *_BODY,
        *axis_columns("rotation", "", "rotation from the start, a unit quaternion", "wxyz"),
        *axis_columns("angular_velocity", "rad/s", "angular velocity"),
        *axis_columns("angular_momentum", "kg m2/s", "about the center of mass"),
        *axis_columns("torque", "N m", f"mean torque about the center of mass {SINCE}"),
    ],
    "wall": [
        *SAMPLE_COLUMNS,
        *axis_columns("momentum", "kg m/s", "of all bodies"),
        *axis_columns("force", "N", f"mean force on walls and colliders {SINCE}"),
    ],
    "one wall": _REACTION,
    "collider": [
        *_REACTION,
        Dataset("work", "", "f8", "J", f"work of the collider on the bodies {SINCE}"),
        Dataset("cumulative_work", "", "f8", "J", "total work of the collider on the bodies"),
    ],
    "joint": [
        *SAMPLE_COLUMNS,
        Dataset("angle", "", "f8", "rad", "of a hinge, 0 at the start; nan for other kinds"),
        Dataset("length", "", "f8", "m", "displacement of a slider, length of a spring; else nan"),
        *axis_columns("force", "N", f"on the first body {IN_LAST_STEP}"),
        *axis_columns("torque", "N m", f"on the first body at the joint's point {IN_LAST_STEP}"),
        Dataset("motor_power", "", "f8", "W", "of the motor in the last step; 0 without a motor"),
    ],
}
