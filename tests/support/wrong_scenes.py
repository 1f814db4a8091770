"""A table of wrong scenes, for tests/scene/test_bad_scenes.py.

Each case is a change of one good scene: old text, new text, key as reported, what the message must
say. The line is where the new text stands, or the one in ELSEWHERE.
"""

GOOD = """\
title = "good"
[domain]
size = ["64 cm", "32 cm", "32 cm"]
cell = "2 cm"
boundary = { default = "slip", bottom = "stick" }
[time]
end = "1 s"
frames = 11
[material.water]
kind = "fluid"
density = 1000
[material.rubber]
kind = "elastic"
youngs_modulus = "0.1 MPa"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.64, 0.32, 0.1]] }
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0, 0, 0], radius = "4 cm" } }
position = [0.3, 0.16, 0.2]
[[coupling]]
kind = "contact"
between = ["water", "rubber"]
friction = 0.1
"""
LAST = "friction = 0.1\n"  # of the scene: what follows it is a list of its own
SPHERE = 'shape = { sphere = { center = [0, 0, 0], radius = "4 cm" } }'


def ball(keys, key, says):
    """Keys that the ball gets as well."""
    return "position =", f"{keys}\nposition =", f"object.ball.{key}", says


def made_of(source, key, says):
    """What the ball is made of instead of a sphere."""
    return SPHERE, source, f"object.ball.{key}", says


def more(text, key, says):
    """Tables behind all others."""
    return LAST, f"{LAST}{text}\n", key, says


def load_with(keys, key, says):
    """A load on the ball; key: "" for the load as a whole."""
    return more(f'[[load]]\nobject = "ball"\n{keys}', f"load.0.{key}".rstrip("."), says)


def probe_with(keys, key, says):
    """A probe; key: "" for the probe as a whole."""
    return more(f'[[probe]]\nname = "a"\n{keys}', f"probe.a.{key}".rstrip("."), says)


def profile(points, says, plus=""):
    """A profile of the ball's volume fraction, below another key of it."""
    key = "volume_fraction_profile"
    return ball(f'{plus}{key} = {{ axis = "x", {points} }}', key, says)


# old text, new text, key as reported, what the message must say; the line is where `new` stands
CASES = {
    "unknown section": ("[time]", "[tiem]", "tiem", "did you mean 'time'?"),
    "missing section": ("[domain]", "[domaine]", "domain", "required table [domain] is missing"),
    "unknown key": ("frames = 11", "frams = 11", "time.frams", "did you mean 'frames'?"),
    "key of another kind": (
        "density = 1000",
        "poisson_ratio = 0.3",
        "material.water.poisson_ratio",
        "known here: kind, preset, density, tait_coefficient",
    ),
    "missing key": ("end = ", "#", "time.end", "required key is missing: simulated time"),
    "wrong unit": ('end = "1 s"', 'end = "1 m"', "time.end", "units: s, ms, us, min, h"),
    "unknown unit": ('cell = "2 cm"', 'cell = "2 inch"', "domain.cell", "'inch' is not a unit"),
    "end beyond all measure": (
        'end = "1 s"',
        "end = 1e308",
        "time.end",
        "must be from 1e-100",
    ),
    "no cfl to speak of": (
        "frames = 11",
        "cfl = 5e-324",
        "time.cfl",
        "from 1e-100 to 1e+100 in size; got 5e-324",
    ),
    "velocity whose square is no number": ball(
        "velocity = [0, -1e160, 0]", "velocity.1", "from 1e-100 to 1e+100 in size; got -1e+160"
    ),
    "density of nothing": (
        "density = 1000",
        'density = "1e-160 g/cm3"',
        "material.water.density",
        "must be from 1e-100 to 1e+100 in size; got '1e-160 g/cm3'",
    ),
    "cell beyond all measure": ('"2 cm"', "1e300", "domain.cell", "from 1e-100 to 1e+100"),
    "no unit": ('cell = "2 cm"', 'cell = "2"', "domain.cell", "the text has no unit"),
    "out of bounds": ("= 1000", '= "-1 g/cm3"', "material.water.density", "must be > 0 kg/m3"),
    "not finite": ("= 1000", "= nan", "material.water.density", "must be > 0 kg/m3; got nan"),
    "wrong type": ("frames = 11", 'frames = "11"', "time.frames", "valid integer; got '11'"),
    "a bool is no number": ("= 1000", "= true", "material.water.density", "got true"),
    "one frame": ("frames = 11", "frames = 1", "time.frames", "greater than or equal to 2"),
    "negative dt": ("frames = 11", "frames = 11\ndt = -1", "time.dt", "must be >= 0 s"),
    "cfl above one": ("frames = 11", "cfl = 1.5", "time.cfl", "must be > 0 and <= 1"),
    "two sizes": ('["64 cm", "32 cm", ', '["64 cm", ', "domain.size", "too few values"),
    "part of a cell": (
        '"32 cm", "32 cm"]',
        '"32 cm", "33 cm"]',
        "domain.size.2",
        "0.33 m is 16.5 cells, nearest are 0.32 m or 0.34 m",
    ),
    "too few cells": ('"32 cm"]', '"4 cm"]', "domain.size.2", "at least 4 cells of 0.02 m"),
    "too many cells": ('"2 cm"', '"2 um"', "domain.size.0", "at most 32768"),
    "wall kind": (
        'bottom = "stick"',
        'bottom = "stik"',
        "domain.boundary.bottom.kind",
        "must be one of stick, slip, separate, open (did you mean 'stick'?); got 'stik'",
    ),
    "friction of a slip wall": (
        'bottom = "stick"',
        'bottom = { kind = "slip", friction = 0.2 }',
        "domain.boundary.bottom",
        'friction is for kind = "separate" only',
    ),
    "wall name": ("bottom =", "botom =", "domain.boundary.botom", "did you mean 'bottom'?"),
    "material kind": (
        'kind = "fluid"',
        'kind = "fluit"',
        "material.water.kind",
        "did you mean 'fluid'?); got 'fluit'",
    ),
    "material kind to come": ('kind = "fluid"', 'kind = "lava"', "material.water.kind", "elastic"),
    "no material kind": ('kind = "fluid"', "", "material.water.kind", "required key is missing"),
    "unknown material": (
        'material = "water"',
        'material = "watr"',
        "object.pool.material",
        "there is no [material.watr] (did you mean 'water'?); defined are water, rubber",
    ),
    "no material": ('material = "rubber"', "", "object.ball.material", "what the body is made of"),
    "same name": ('name = "ball"', 'name = "pool"', "object.pool.name", "is taken: "),
    "bad name": (
        'name = "ball"',
        'name = "8 ball"',
        "object.8 ball.name",
        "must begin with a letter",
    ),
    "two sources": (
        'material = "rubber"',
        'material = "rubber"\nmesh = "a.obj"',
        "object.ball.shape",
        "mesh and shape given at once",
    ),
    "no source": ("shape = { sphere", "#", "object.ball", "give one of gaussians, mesh, shape"),
    "two sizes given": ball(
        'height = "1 cm"\nwidth = "1 cm"', "width", "height and width given at once"
    ),
    "two places": ball("origin = [0, 0, 0]", "origin", "position and origin given at once"),
    "fill of a shape": ball("fill = true", "fill", "is only for"),
    "select of a shape": ball(
        "select = { min_opacity = 0.1 }",
        "select",
        "is only for objects made of gaussians, not of a shape",
    ),
    "pruned shape": ball(
        'prune = "auto"', "prune", "is only for objects made of gaussians or a mesh"
    ),
    "nothing to ride": ball(
        "passive_gaussians = true", "passive_gaussians", 'needs prune = "auto" or "versagauss"'
    ),
    "unknown transfer": (
        'title = "good"',
        'title = "good"\n[accuracy]\ntransfer = "flop"',
        "accuracy.transfer",
        "must be one of apic, apic-corrected, aflip, flip, pic (did you mean 'flip'?); got 'flop'",
    ),
    "output field": (
        'title = "good"',
        'title = "good"\n[output]\nfields = ["velocty"]',
        "output.fields.0",
        "velocity, J, F, stress, pressure, strain, volume_fraction (did you mean 'velocity'?)",
    ),
    "scenery with mass": (
        'material = "rubber"',
        'role = "scenery"\nmaterial = "rubber"',
        "object.ball.material",
        "is not for scenery",
    ),
    "body as collider": ball("collider = true", "collider", "is"),
    "color": ball('color = "reed"', "color", "'#6fb7d6'"),
    "axis": ball(
        'rotation = { axis = "w", angle = "3 deg" }',
        "rotation.axis",
        "'x', '-x', 'y', '-y', 'z', '-z' or three numbers",
    ),
    "particles per cell": ball("particles_per_cell = 9", "particles_per_cell", "1, 8, 27 or 64"),
    "shape of two forms": (
        "shape = { sphere",
        "shape = { box = [[0, 0, 0], [1, 1, 1]], sphere",
        "object.ball.shape",
        "has box and sphere: give exactly one",
    ),
    "shape form": ("{ sphere =", "{ spere =", "object.ball.shape.spere", "did you mean 'sphere'?"),
    "box turned over": (
        "[0.64, 0.32, 0.1]]",
        "[0.64, 0, 0.1]]",
        "object.pool.shape.box",
        "y0 < y1",
    ),
    "union of one": (
        "shape = { box = [[0, 0, 0], [0.64, 0.32, 0.1]] }",
        "shape = { union = [{ box = [[0, 0, 0], [0.64, 0.32, 0.1]] }] }",
        "object.pool.shape.union",
        "needs at least 2 shapes; got 1",
    ),
    "negative radius": ('"4 cm"', '"-4 cm"', "object.ball.shape.sphere.radius", "must be > 0 m"),
    "mixed phase": ball(
        'phase = "fluid"',
        "phase",
        "'fluid' already holds a fluid, object 'pool', this is a solid: to share one velocity"
        " field, 'pool' must name it too",
    ),
    "an unknown color transfer": (
        "[domain]",
        '[appearance]\ncolor_transfer = "frames"\n[domain]',
        "appearance.color_transfer",
        "must be one of off, frame, relax, step (did you mean 'frame'?)",
    ),
    "colors of nobody": (
        "[domain]",
        '[appearance]\ncolor_objects = ["pool", "bal"]\n[domain]',
        "appearance.color_objects.1",
        "there is no object 'bal' (did you mean 'ball'?); known: pool, ball",
    ),
    "opacity scale of a solid": ball("opacity_scale = 0.1", "opacity_scale", "is only for fluids"),
    "missing file": made_of('gaussians = "none.ply"', "gaussians", "there is no file "),
    "misspelt file": made_of('mesh = "scena.toml"', "mesh", "(did you mean 'scene.toml'?)"),
    "file of a long name": made_of(f'mesh = "{"a" * 5000}.obj"', "mesh", "there is no file "),
    "file with NUL": made_of('gaussians = "a\\u0000b.ply"', "gaussians", "no file has such a name"),
    "folder with NUL": more(
        '[output]\nfolder = "a\\u0000b"',
        "output.folder",
        "no folder has such a name; got 'a\\x00b'",
    ),
    "file outside": made_of(
        'gaussians = "../outside.ply"',
        "gaussians",
        "lies outside the scene's folder: move it below, or set allow_outside = true",
    ),
    "no position": (
        'shape = { sphere = { center = [0, 0, 0], radius = "4 cm" } }\nposition =',
        'gaussians = "inside.ply"\n#',
        "object.ball",
        "needs a position (of the middle of its base) or an origin",
    ),
    "coupling of nothing": (
        'between = ["water", "rubber"]',
        'between = ["water", "ruber"]',
        "coupling.0.between.1",
        "there is no [material.ruber] (did you mean 'rubber'?)",
    ),
    "coupling kind": ('kind = "contact"', 'kind = "contakt"', "coupling.0.kind", "'contact'?"),
    "coupling twice": (
        "friction = 0.1",
        "friction = 0.1\n[[coupling]]\n"
        'kind = "contact"\nbetween = ["rubber", "water"]\nfriction = 0',
        "coupling.1.between",
        "is about the same two already",
    ),
    "load of nothing": more(
        '[[load]]\nobject = "bal"\nforce = [0, 0, 1]',
        "load.0.object",
        "there is no object 'bal' (did you mean 'ball'?); known: pool, ball",
    ),
    "load of a list": more(
        '[[load]]\nobject = ["ball", "sky"]\nforce = [0, 0, 1]',
        "load.0.object.1",
        "there is no object 'sky'; known: pool, ball",
    ),
    "load without strength": load_with("", "", "give one of force, pressure, acceleration"),
    "load of two kinds": load_with(
        "force = [0, 0, 1]\nacceleration = [0, 0, 1]",
        "acceleration",
        "force and acceleration given at once: give exactly one",
    ),
    "pressure on no face": load_with(
        'pressure = "1 kPa"',
        "face",
        "required with pressure: one of west, east, south, north, bottom, top",
    ),
    "face of a force": load_with('force = [0, 0, 1]\nface = "top"', "face", "is for pressure only"),
    "load that ends before it begins": load_with(
        'force = [0, 0, 1]\nstart_time = "2 s"\nend_time = "1 s"',
        "end_time",
        "must be later than start_time = 2 s; got 1 s",
    ),
    "force in kilograms": load_with(
        'force = [0, 0, "1 kg"]', "force.2", "'kg' does not measure a force; expected a number [N]"
    ),
    "region of two forms": load_with(
        "force = [0, 0, 1]\nregion = { cube = 1 }", "region", "has no form: give one of box, sphere"
    ),
    "probe of nothing": probe_with(
        "sampling_rate = 10", "", "give one of pressure, surface_height, velocity, object, wall"
    ),
    "probe of two things": probe_with(
        'sampling_rate = 10\nwall = "all"\nsurface_height = [0, 0]',
        "wall",
        "surface_height and wall given at once: give exactly one",
    ),
    "probe without a sampling rate": probe_with(
        'wall = "all"', "", "needs a sampling_rate or a sampling_interval"
    ),
    "sampling rate and interval": probe_with(
        'wall = "all"\nsampling_rate = "1 Hz"\nsampling_interval = "1 s"',
        "sampling_interval",
        "sampling_rate and sampling_interval given at once: give one",
    ),
    "probe twice": more(
        2 * '[[probe]]\nname = "a"\nwall = "all"\nsampling_rate = 1\n', "probe.a.name", "is taken: "
    ),
    "probe outside": probe_with(
        'sampling_rate = 1\npressure = [0.1, 0.1, "40 cm"]',
        "pressure.2",
        "lies outside the domain, 0 .. 0.32 m; got 0.4 m",
    ),
    "probe of no object": probe_with(
        'sampling_rate = 1\nobject = "boll"', "object", "did you mean 'ball'?"
    ),
    "fraction given twice": profile(
        "positions = [0, 1], values = [0, 1]",
        "volume_fraction and volume_fraction_profile given at once",
        "volume_fraction = 0.5\n",
    ),
    "profile of two lengths": profile(
        "positions = [0, 1, 2], values = [0, 1]",
        "positions and values must be of one length, 2 or more",
    ),
    "unsorted profile": profile("positions = [1, 0], values = [0, 1]", "positions must ascend"),
    "fraction above one": ball("volume_fraction = 1.5", "volume_fraction", "must be > 0 and <= 1"),
    "a solid": ball('initial_pressure = "hydrostatic"', "initial_pressure", "is only for fluids"),
}

# found while the particles are made
BUILD_CASES = {
    "outside": (
        "position = [0.3, 0.16, 0.2]",
        "position = [0.62, 0.16, 0.2]",
        "object.ball.position",
        "outside the domain: it reaches x = 0.58 .. 0.66 m, the domain 0 .. 0.64 m",
    ),
    "shape outside": (
        "[0.64, 0.32, 0.1]]",
        "[0.64, 0.32, 0.5]]",
        "object.pool.shape",
        "z = 0 .. 0.5 m, the domain 0 .. 0.32 m",
    ),
    "too thin": (
        "[0, 0, 0], [0.64, 0.32, 0.1]",
        "[0, 0, 0.051], [0.64, 0.32, 0.052]",
        "object.pool.shape",
        "no particle fits in, their spacing is 0.01 m",
    ),
    "not Gaussians": made_of('gaussians = "inside.ply"', "gaussians", "is not a .ply file"),
    "Gaussians of an unknown kind": made_of(
        'gaussians = "inside.obj"', "gaussians", "allowed: a name that ends in .ply, .splat, .spz"
    ),
    "load on nothing": load_with(
        'force = [0, 0, 1]\nregion = { sphere = { center = [0, 0, 0], radius = "1 cm" } }',
        "region",
        "holds no particle of ball at the start",
    ),
    "fraction of nothing": profile(
        "positions = [0, 1], values = [0, 0]", "leaves no particle: its values are 0 everywhere"
    ),
    "not a mesh": made_of('mesh = "inside.ply"', "mesh", "cannot be read as a mesh"),
}

# where the reported line is not the changed one: the line of what holds the key
ELSEWHERE = {
    "missing section": 1,
    "too many cells": 3,
    "missing key": 6,
    "no material kind": 9,
    "no material": 19,
    "no source": 19,
    "no position": 19,
    "two sources": 23,
}
