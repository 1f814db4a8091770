"""Name, shape, type, unit and meaning of every dataset of every file: the single source.

`python -m vgmpi.output.layout > docs/file-format.md` writes the page that people read.
"""

import re
from typing import NamedTuple

import numpy as np

SCHEMA = 1  # raised when a reader of the old files would go wrong

FRAMES, CHECKPOINTS = "frames", "checkpoints"  # folders inside the output folder
LOCK = "run.lock"  # of the run that writes here now
BLOWUP = "blowup"  # the same for the state in which a run ended
SERIES, GAUSSIANS, LEDGER = "series.vtkhdf", "gaussians.h5", "ledger.csv"
PROBE_NAME = "probe_{}.csv"
FRAME_NAME = "frame_{:05d}.vtkhdf"
MOST_FRAMES = 1_000_000
CHECKPOINT_NAME = "checkpoint_{:09d}.h5"  # its manifest: the same name, .json
CRC = "crc"  # the dataset or column that holds the checksums of the others
CRC_ROWS = 1 << 16  # rows per checksum in a manifest


class Dataset(NamedTuple):
    """One dataset: `shape` in words of the page, `dtype` numpy short names joined by |."""

    name: str
    shape: str
    dtype: str
    unit: str
    meaning: str


def frame_number(name: str) -> int | None:
    """Number of the frame that a file of this name is; None where it is no name of a frame."""
    match = re.fullmatch(r"frame_([0-9]{5,6})\.vtkhdf", name)
    number = int(match[1]) if match else -1
    return number if FRAME_NAME.format(number) == name else None


def row_shape(dataset: Dataset) -> tuple[int | None, ...]:
    """Shape of one row; None where any length goes: "(n, K, 3)" -> (None, 3)."""
    words = [w.strip() for w in dataset.shape.strip("()").split(",") if w.strip()]
    return tuple(int(w) if w.isdigit() else None for w in words[1:])


def fits(dataset: Dataset, array: np.ndarray) -> bool:
    """Whether rows of this array are what the dataset says."""
    want = row_shape(dataset)
    have = array.shape[1:]
    return (
        len(want) == len(have)
        and all(w is None or w == h for w, h in zip(want, have))
        and array.dtype.str[1:] in dataset.dtype.split("|")
    )


def named(datasets: list[Dataset]) -> dict[str, Dataset]:
    return {d.name: d for d in datasets}


# ---- frames/frame_00000.vtkhdf ----------------------------------------------------------------
# In the file, x is /VTKHDF/Points and the others are in /VTKHDF/PointData.
FRAME = [
    Dataset("id", "(n,)", "i8", "1", "particle number, ascending; its row in gaussians.h5"),
    Dataset("x", "(n, 3)", "f4", "m", "position in the domain; stored as /VTKHDF/Points"),
    Dataset("velocity", "(n, 3)", "f4", "m/s", "velocity"),
    Dataset(
        "J", "(n,)", "f4", "1", "volume now / volume at rest; its elastic part if a law yields"
    ),
    Dataset("F", "(n, 9)", "f4", "1", "deformation gradient, row by row; cbrt(J) I without one"),
    Dataset(
        "colour",
        "(n, 3 K)",
        "f4",
        "1",
        "colour as `sh` of gaussians.h5, coefficient by coefficient; nan where it does not travel; "
        "only with appearance.colour_transfer = step",
    ),
    Dataset("object", "(n,)", "i4", "1", "number of the object in the list `objects`"),
    Dataset("phase", "(n,)", "i4", "1", "number of the velocity field it moves with"),
]
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
    Dataset("Lines/*", "(0 or 1,)", "i8", "1", "empty; VTK asks for them (also Polygons, Strips)"),
]
SUMS = Dataset(CRC, "()", "text", "", "JSON, CRC32 (zlib) of the bytes of every other dataset")
FRAME_OWN = [
    Dataset("frame", "()", "i8", "1", "number of the frame, as in the name of its file"),
    Dataset("gaussians", "()", "u4", "1", "by which the gaussians.h5 of its particles is known"),
    SUMS,
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
    SUMS._replace(meaning="as in a frame, of the datasets that are not virtual"),
]

# ---- gaussians.h5 -----------------------------------------------------------------------------
GAUSSIAN = [
    Dataset("x0", "(n, 3)", "f8", "m", "position at the start, in the domain; at a source's mouth"),
    Dataset("vol0", "(n,)", "f8", "m3", "rest volume"),
    Dataset("object", "(n,)", "i4", "1", "number of the object in the list `objects`"),
    Dataset(
        "v0",
        "(n, 3)",
        "f8",
        "m/s",
        "velocity at the start, or at a source's mouth; only if something moves then",
    ),
    Dataset("theta0", "(n,)", "f8", "1", "ln J at the start; only if something is compressed then"),
    Dataset(
        "surface0",
        "(n, 10)",
        "f4",
        "1, m, 1/m",
        "surface of a solid at rest: outward normal, as long as it is sure, signed distance"
        " (negative inside), and the normal's gradient xx, xy, xz, yy, yz, zz; only if one may"
        " touch something",
    ),
    Dataset("cov0", "(n, 6)", "f4", "m2", "rest covariance: xx, xy, xz, yy, yz, zz"),
    Dataset("opacity", "(n,)", "f4", "1", "0 to 1"),
    Dataset("sh", "(n, K, 3)", "f4", "1", "spherical harmonics of the colour, K = 1, 4, 9 or 16"),
]
OPTIONAL = ("v0", "theta0", "surface0")
SCENERY = [
    Dataset("x0", "(m, 3)", "f8", "m", "position; scenery has no mass and does not move"),
    Dataset("object", "(m,)", "i4", "1", "number of the object in the list `objects`"),
    Dataset("cov0", "(m, 6)", "f4", "m2", "covariance: xx, xy, xz, yy, yz, zz"),
    Dataset("opacity", "(m,)", "f4", "1", "0 to 1"),
    Dataset("sh", "(m, K, 3)", "f4", "1", "spherical harmonics of the colour"),
]
PASSIVE = [
    Dataset("x0", "(p, 3)", "f8", "m", "position at rest"),
    Dataset("object", "(p,)", "i4", "1", "number of the object in the list `objects`"),
    Dataset("cov0", "(p, 6)", "f4", "m2", "rest covariance: xx, xy, xz, yy, yz, zz"),
    Dataset("opacity", "(p,)", "f4", "1", "0 to 1"),
    Dataset("sh", "(p, K, 3)", "f4", "1", "spherical harmonics of the colour"),
    Dataset("carriers", "(p, 4)", "i8", "1", "numbers of the particles that carry it"),
    Dataset("weights", "(p, 4)", "f4", "1", "their weights; they add up to 1"),
]
GAUSSIAN_TEXTS = [
    Dataset(
        "objects",
        "()",
        "text",
        "",
        "JSON, an entry per object, then per source: name, role, material, kind, family, "
        "deforms (whether F of the frames is that of its particles), phase, "
        "colour_set (colours travel among objects of one number), "
        "density [kg/m3] with its pores, first and count (its rows), opacity_scale, alpha_min, "
        "color, collider, and transform (4 x 4, source coordinates -> domain coordinates [m])",
    ),
    Dataset("scene", "()", "text", "", "JSON, the scene with every default filled in, SI"),
    SUMS,
]

# ---- checkpoints/checkpoint_000000000.h5 ------------------------------------------------------
# A group is one phase of one material, group_000, group_001, ... in the order of their names. Its
# rows stand in the order of the last sort, which is state: block along the Hilbert curve, cell, id.
CHECKPOINT = [
    Dataset("*/block", "(b,)", "i8", "1", "number of each block that holds particles of the group"),
    Dataset("*/count", "(b,)", "i8", "1", "particles in each of these blocks"),
    Dataset("*/id", "(n,)", "i8", "1", "particle number, its row in gaussians.h5"),
    Dataset(
        "*/x",
        "(n, 3)",
        "i4|i8|f4|f8",
        "2^-29|2^-52 cell",
        "position from the middle of the block, in fixed point (single|double precision)",
    ),
    Dataset("*/v", "(n, 3)", "f4|f8", "m/s", "velocity"),
    Dataset("*/C", "(n, 9)", "f4|f8", "1/s", "APIC affine velocity, row by row"),
    Dataset("*/vol0", "(n, 1)", "f4|f8", "m3", "rest volume"),
    Dataset(
        "*/state",
        "(n, *)",
        "f4|f8",
        "1",
        "the law's state: theta = ln J of fluids, F - I of elastic solids; b_e - I (00, 11, 22, "
        "01, 02, 12) and a history of laws that yield; behind it the share of space in pores, and "
        "F - I of bodies whose law does not know it",
    ),
]
CHECKPOINT_TEXTS = [
    Dataset(
        "attrs",
        "()",
        "text",
        "",
        "JSON: schema, step, time [s], the scene's text and resolved form, versions of the program "
        "and its libraries, and whatever else the run needs to go on with the same bits",
    ),
]

# ---- ledger.csv -------------------------------------------------------------------------------
LEDGER_COLUMNS = [
    Dataset("time", "", "f8", "s", "simulated time"),
    Dataset("step", "", "i8", "1", "number of time steps made"),
    Dataset("phase", "", "text", "", "name of the phase"),
    Dataset("count", "", "i8", "1", "particles"),
    Dataset("mass", "", "f8", "kg", "mass"),
    *(Dataset(f"momentum_{a}", "", "f8", "kg m/s", f"momentum along {a}") for a in "xyz"),
    *(
        Dataset(f"angular_{a}", "", "f8", "kg m2/s", f"angular momentum about {a} and the origin")
        for a in "xyz"
    ),
    Dataset("kinetic", "", "f8", "J", "kinetic energy, of the affine motion of APIC too"),
    Dataset("elastic", "", "f8", "J", "elastic energy"),
    Dataset("potential", "", "f8", "J", "energy of height in gravity"),
    Dataset("J_min", "", "f8", "1", "smallest volume ratio, as in the frames"),
    Dataset("J_max", "", "f8", "1", "largest volume ratio, as in the frames"),
]
FLOW_COLUMNS = [  # with sources or sinks
    Dataset("count_in", "", "i8", "1", "particles that were there at the start or came since"),
    Dataset("mass_in", "", "f8", "kg", "their mass"),
    Dataset("count_out", "", "i8", "1", "particles that ended in sinks"),
    Dataset("mass_out", "", "f8", "kg", "their mass"),
]

ROW_SUM = Dataset(
    CRC, "", "i8", "1", "CRC32 (zlib) of the row's text before it, going on from the row above"
)

# ---- probe_NAME.csv ---------------------------------------------------------------------------
_WHEN = LEDGER_COLUMNS[:2]
PROBE_COLUMNS = {
    "pressure": [
        *_WHEN,
        Dataset("pressure", "", "f8", "Pa", "mean of the fluids near; nan where there is none"),
    ],
    "level": [*_WHEN, Dataset("level", "", "f8", "m", "height of the surface; 0 where it is dry")],
    "velocity": [
        *_WHEN,
        *(
            Dataset(f"velocity_{a}", "", "f8", "m/s", f"mean velocity along {a}; nan in a void")
            for a in "xyz"
        ),
    ],
    "object": [
        *_WHEN,
        Dataset("mass", "", "f8", "kg", "mass"),
        *(Dataset(f"center_{a}", "", "f8", "m", f"{a} of the centre of mass") for a in "xyz"),
        *(Dataset(f"velocity_{a}", "", "f8", "m/s", f"mean velocity along {a}") for a in "xyz"),
        *(Dataset(f"momentum_{a}", "", "f8", "kg m/s", f"momentum along {a}") for a in "xyz"),
        *(
            Dataset(f"force_{a}", "", "f8", "N", f"mean force along {a} since the row before, "
                    "without its weight; nan in the first row")
            for a in "xyz"
        ),
    ],
    "wall": [
        *_WHEN,
        *(Dataset(f"momentum_{a}", "", "f8", "kg m/s", f"of all bodies, along {a}") for a in "xyz"),
        *(
            Dataset(f"force_{a}", "", "f8", "N", f"mean force along {a} on walls and colliders "
                    "since the row before; nan in the first row")
            for a in "xyz"
        ),
    ],
}  # fmt: skip

# ---- the page ---------------------------------------------------------------------------------
INTRODUCTION = """\
# Files of a run

This page is written by `python -m vgmpi.output.layout`; edit `vgmpi/output/layout.py` instead.

    out/
      gaussians.h5                    a row per particle, written once at the start
      frames/frame_00000.vtkhdf ...   a file per frame; pyvista.read() gives PolyData
      series.vtkhdf                   all frames as one time series, for ParaView
      ledger.csv                      a row per frame and phase: mass, momentum, energy
      probe_NAME.csv                  a row per due time of a [[probe]]
      checkpoints/                    the last two states to go on from
      blowup/frames/                  the state in which a run blew up, if one did

All numbers are SI. Positions are domain coordinates: the box starts at (0, 0, 0) and z is up; the
way back to the coordinates an object came in is its `transform`. n is the number of particles, f4
and f8 are single and double precision, i4 and i8 whole numbers. HDF5 files are plain: contiguous,
uncompressed, readable with any HDF5 since 1.8 (series.vtkhdf: 1.10). A file has its final name only
when it is complete: it is written as `NAME.tmp`, brought to the disk, then renamed. The bytes of
every file are the same for any number of ranks.

What is read is what was written: every file holds checksums (a checkpoint's are in its manifest),
and whoever reads compares them and names the file, and the dataset or line, that is damaged. Files
are plain: one that is a link, or that has its numbers in another file, is refused, but for
series.vtkhdf, which is put together of the frames of its folder. `--inspect FILE` verifies a whole
file.
"""
ABOUT_CHECKPOINTS = f"""\
`checkpoint_000000000.json`, the manifest, is written last: size of the file, and for every dataset
its shape, type and a CRC32 (zlib) for each {CRC_ROWS} rows. A checkpoint without a manifest, or one
that differs from it or from its name, is passed over. The last two are kept. At a resume every row
is also held against the scene (numbers, positions in the domain, particles of the group, each there
once): what cannot be ends it with one line and exit code 2.
"""
ABOUT_TABLES = """\
A row per frame and phase, numbers with all their digits. A row that was changed since is named with
its line where the table is read, and a resume refuses it, also one that lacks its last rows: the
checkpoint knows the `crc` of the last row before it. A last line without an end, cut off by a
kill, is left out. `crc` is `zlib.crc32(words, before)`: words are the bytes of the line before its
last comma, before is the crc of the line above, 0 in the first. Tables of earlier versions have no
`crc`, and get it at a resume.
"""


def _table(datasets, prefix=""):
    lines = ["| name | shape | type | unit | meaning |", "|---|---|---|---|---|"]
    for d in datasets:
        kind = d.dtype.replace("|", " or ")
        words = (f"`{prefix}{d.name}`", d.shape, kind, d.unit, d.meaning)
        lines.append("| " + " | ".join(w.replace("|", "\\|") for w in words) + " |")
    return "\n".join(lines) + "\n"


def page() -> str:
    """docs/file-format.md."""
    parts = [
        INTRODUCTION,
        "## frames/frame_00000.vtkhdf\n",
        "VTKHDF 2.0 PolyData, one part, rows in ascending `id`. A frame is known by its number: "
        "where one is missing the others keep theirs, and the renderer says which it leaves out. "
        "`id` and `x` are always there, "
        "the others as the scene asks for them. Covariance, opacity and colour are not repeated "
        "here: a renderer takes them from gaussians.h5 by `id` and moves them with F or J.\n",
        _table([d for d in FRAME if d.name != "x"], "VTKHDF/PointData/"),
        _table([d._replace(name="Points") for d in FRAME if d.name == "x"], "VTKHDF/"),
        _table(FRAME_FIELD_DATA, "VTKHDF/FieldData/"),
        _table(FRAME_TOPOLOGY, "VTKHDF/"),
        _table(FRAME_OWN),
        "Attributes: `VTKHDF/Type`, `VTKHDF/Version`, and `/schema` (whole number). Frames of "
        "earlier versions have no `frame` and no `crc`: they are read, and nothing vouches for "
        "them. `gaussians` is the CRC32 of the checksums in gaussians.h5, those of its texts left "
        "out, as JSON pairs in the order of their names; checkpoints have it too.\n",
        "## series.vtkhdf\n",
        "The frames one after the other, as virtual datasets of the same names: it holds no "
        "numbers itself and finds the frames beside it, from any working directory. It is valid "
        "after every frame.\n",
        _table(SERIES_STEPS, "VTKHDF/"),
        _table(SERIES_OWN),
        "## gaussians.h5\n",
        "A row per particle id, also for particles that are not there yet: frames hold those that "
        "are. Objects are contiguous, in the order of the scene; sources follow, layer by layer.\n",
        _table(GAUSSIAN),
        "Drawn, but without mass (only if the scene has scenery):\n",
        _table(SCENERY, "scenery/"),
        "Gaussians without mass that ride along (only if an object has `passive`). With weights w, "
        "carriers i and their deformation gradients F_i in a frame: x = sum w_i (x_i + F_i (x0 - "
        "x0_i)), F = sum w_i F_i, covariance F cov0 F^T.\n",
        _table(PASSIVE, "passive/"),
        _table(GAUSSIAN_TEXTS),
        "Attributes: `schema` (whole number), `digest` (text; says which preparation it is).\n",
        "## checkpoints/checkpoint_000000000.h5\n",
        "The number is the step. A group is one phase of one material: group_000, group_001, ... "
        "Rows stand in the order of the last sort, which is state: a resumed run goes on with "
        "the same bits on any number of ranks.\n",
        _table(CHECKPOINT),
        _table(CHECKPOINT_TEXTS),
        ABOUT_CHECKPOINTS,
        "## ledger.csv\n",
        ABOUT_TABLES,
        _table([*LEDGER_COLUMNS, ROW_SUM]),
        "Before `crc`, only with `[[source]]` or `[[sink]]`; count_in - count_out is `count`, "
        "exactly, and mass_in - mass_out is `mass`, to rounding:\n",
        _table(FLOW_COLUMNS),
        "Momentum and energy change by gravity, walls, colliders, loads, sources and sinks. With "
        "`domain.gravity_ramp` the potential energy is that of gravity at its full strength, with "
        "`domain.gravity_keyframes` that of gravity then.\n",
        "## probe_NAME.csv\n",
        "A row per due time, written after the step that reaches it, numbers with all their "
        "digits; its columns by what the probe measures, and `crc` as in ledger.csv:\n",
        *(f"### {kind}\n\n{_table(columns)}" for kind, columns in PROBE_COLUMNS.items()),
    ]
    return "\n".join(parts)


if __name__ == "__main__":
    print(page(), end="")
