"""A run from scene to files: prepare, plan, step, write, stop."""

import hashlib
import json
import logging
import platform
import subprocess
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from ..colours import shades
from ..domain.ranks import Alone
from ..output import checkpoint, layout, rest, store
from ..output.frames import Frames
from ..output.ledger import Ledger
from ..output.read import RunError, read_gaussians
from ..plan import Plan, make_plan
from ..prepare import texture
from ..prepare.loads import find
from ..prepare.motion import gradient
from ..price import describe
from ..scene import Scene
from .probes import Probes
from .requests import Requests
from .state import frame_rows, restore, save
from .step import BlowUp, Simulation
from .timestep import next_step
from .warm import warm
from .watch import ledger

log = logging.getLogger("vgmpi")

DONE, BLEW_UP, STOPPED = 0, 3, 75


@dataclass
class Options:
    """How to run, beyond what the scene says."""

    folder: Path | None  # None: nothing is written
    threads: int = 1
    resume: Path | None = None
    stop_steps: int = 0
    stop_seconds: float = 0.0
    listeners: list = field(default_factory=list)  # each called with (simulation) after every step
    watchers: list = field(default_factory=list)  # each called with (run) at every frame


@dataclass
class Prepared:
    """What all ranks know of the particles before they hold any."""

    objects: list[dict]
    volume: list[float]
    center: list[list[float]]  # of mass [m]
    colliders: list
    loads: list
    shades: np.ndarray | None = None  # of the objects' colours (colours.shades), where they travel
    rows: dict | None = None  # on rank 0, where there is no gaussians.h5: its datasets

    @property
    def count(self) -> list[int]:
        return [thing["count"] for thing in self.objects]


def prepare(scene: Scene, ranks: Alone, folder: Path | None) -> Prepared:
    """Make the particles on rank 0 and write gaussians.h5 (or keep them, if folder is None).
    Collective.

    Particles already there from the same objects are used again. Raises SceneError on all ranks.
    """
    said, known, rows = None, None, None
    if ranks.rank == 0:
        try:
            known, rows = _particles(scene, folder)
        except Exception as error:  # every rank must hear of it, or they wait for ever
            said = error
    said = ranks.bcast(said)
    if said is not None:
        raise said
    known = ranks.bcast(known)
    if folder is None and ranks.rank == 0:
        known.rows = rows[1]
    if folder is not None and ranks.bcast(rows is not None):
        scenery, rows, passive = rows or (None, None, None)
        rest.write(
            folder / layout.GAUSSIANS,
            ranks,
            rows,
            known.objects,
            scenery,
            scene.resolved(),
            digest(scene),
            passive,
        )
    return known


def _particles(scene: Scene, folder: Path | None):
    """On rank 0: what all shall know, and (scenery, rows, passive) to write, None if they are on
    disk."""
    path = folder / layout.GAUSSIANS if folder is not None else None
    moving = not any(thing.collider for thing in scene.object)
    if path is not None and moving and rest.digest(path) == digest(scene):
        log.info("particles as prepared before: %s", path)
        found = read_gaussians(path)
        loads = find(scene, found.x0, found.vol0, found.object)
        return _known(scene, found.objects, found, found.x0, [], loads), None
    from ..prepare.build import build  # scipy comes with it: only the rank that prepares waits

    made = build(scene)
    rows = {
        "x0": made.x,
        "vol0": made.vol0,
        "object": made.object,
        "cov0": made.cov0,
        "opacity": made.opacity,
        "sh": made.sh,
    }
    if made.v0.any():
        rows["v0"] = made.v0
    if made.theta0.any():
        rows["theta0"] = made.theta0
    scenery = None
    if made.scenery is not None:
        s = made.scenery
        scenery = {"x0": s.x, "object": s.object, "cov0": s.cov0, "opacity": s.opacity, "sh": s.sh}
    passive = None
    if made.passive is not None:
        p = made.passive
        passive = {"x0": p.x, "object": p.object, "cov0": p.cov0, "opacity": p.opacity, "sh": p.sh}
        passive |= {"carriers": p.carriers, "weights": p.weights}
    return known_of(scene, made), (scenery, rows, passive)


def known_of(scene: Scene, made) -> Prepared:
    """What all ranks shall know of what prepare.build made."""
    return _known(scene, made.objects, made, made.x, made.colliders, made.loads)


def _known(scene, objects, rest, x, colliders, loads) -> Prepared:
    """rest: object (n,) of each particle, vol0 (n,) [m3] and sh (n, K, 3). x: (n, 3) [m]."""
    thing, volume, x = (np.asarray(rows) for rows in (rest.object, rest.vol0, x))
    total = np.bincount(thing, volume, minlength=len(objects))
    moment = [np.bincount(thing, volume * x[:, a], minlength=len(objects)) for a in range(3)]
    center = (np.array(moment) / np.maximum(total, 1e-300)).T
    travel = scene.appearance.colour_transfer == "step"
    hues = shades(len(objects), rest.object, rest.sh) if travel else None
    return Prepared(objects, total.tolist(), center.tolist(), colliders, loads, hues)


def plan_for(scene: Scene, known: Prepared) -> Plan:
    """What the scene needs with these particles. Raises SceneError."""
    colliders = bool(known.colliders)
    return make_plan(scene, known.count, known.volume, colliders, known.center, known.shades)


def digest(scene: Scene) -> str:
    """What the particles depend on: the scene's text as resolved, the files it reads, this
    program's version.
    """
    seal = hashlib.sha256(json.dumps(scene.resolved(), sort_keys=True).encode())
    for name in sorted(scene.files):
        for path in (Path(scene.files[name]), *texture.files(Path(scene.files[name]))):
            seal.update(path.read_bytes())
    for path in sorted(Path(__file__).parent.parent.glob("prepare/*.py")):
        seal.update(path.read_bytes())
    return seal.hexdigest()


def begin(
    scene: Scene, plan: Plan, known: Prepared, ranks: Alone, options: Options
) -> tuple[Simulation, int]:
    """The simulation at its start, or at the checkpoint to resume from; and the next frame's
    number. Collective.
    """
    warm(plan, ranks)
    simulation = Simulation(plan, ranks, known.colliders, options.threads, known.loads)
    if options.resume is not None:
        path = options.resume
        with _on_all(ranks, path, lambda: checkpoint.open(path)) as saved:
            restore(simulation, saved)
            return simulation, saved.attrs["frame"]
    ids, rows = _share(plan, known, ranks, options.folder)
    v = rows.get("v0", np.zeros_like(rows["x0"]))
    C = gradient(scene, rows["x0"], rows["object"])
    simulation.put(
        rows["x0"], v, rows["vol0"], ids, rows["object"], rows.get("theta0"), C, rows.get("sh")
    )
    return simulation, 0


def _share(plan: Plan, known: Prepared, ranks: Alone, folder: Path | None):
    """Ids and rows of the particles this rank brings: of a file an equal share, without a file all
    on rank 0.
    """
    if folder is None:
        rows = known.rows
        if rows is None:
            none = np.zeros(0)
            rows = {"x0": np.zeros((0, 3)), "vol0": none, "object": none.astype(np.int32)}
        return np.arange(len(rows["x0"])), rows
    total = plan.particles
    first, last = total * ranks.rank // ranks.size, total * (ranks.rank + 1) // ranks.size
    path = folder / layout.GAUSSIANS
    rows = _on_all(ranks, path, lambda: rest.read_slice(path, first, last))
    return np.arange(first, last), rows


def _on_all(ranks: Alone, path: Path, action):
    """action() on every rank; what fails on one is the same StoreError on all. Collective."""
    found, error = None, None
    try:
        found = action()
    except (OSError, checkpoint.CheckpointError, RunError) as caught:
        error = caught
    store.agree(ranks, error, path, "read")
    return found


class Run:
    """One run: its simulation and its files. Collective.

    probes: rows of the scene's probes; frame: number of the next frame.
    """

    def __init__(self, scene: Scene, plan: Plan, known: Prepared, ranks: Alone, options: Options):
        self.scene, self.plan, self.options, self.ranks = scene, plan, options, ranks
        self.names = [thing["name"] for thing in known.objects]
        self.simulation, self.frame = begin(scene, plan, known, ranks, options)
        last_step = None if options.resume is None else self.simulation.step
        self.probes = Probes(scene, self.simulation, options.folder, last_step)
        if options.folder is not None:
            self._open(options.folder, last_step)
        self.first_step = self.simulation.step
        self.requests = Requests(options.stop_steps, options.stop_seconds, scene.output.checkpoint)
        self.warned = False
        self.opening: list[dict] = []
        self.latest: list[dict] = []

    def _open(self, folder: Path, last_step: int | None) -> None:
        self.frames = Frames(folder, self.ranks, self.plan.particles, self.frame)
        self.ledger = Ledger(folder, self.ranks, last_step)
        self.checkpoints = folder / layout.CHECKPOINTS
        if last_step is None:
            checkpoint.clear(self.checkpoints, self.ranks)

    def go(self) -> int:
        """Run to the end of the scene or until asked to stop; returns the exit code."""
        simulation = self.simulation
        self.opening = self.latest = ledger(simulation)
        if self.frame == 0:
            self._write_frame()
            self.probes.first()
        try:
            while self.frame < len(self.plan.times):
                if self._step():
                    self._checkpoint()
                    return STOPPED
        except BlowUp as error:
            return self._blew_up(str(error).format(*self.names))
        return DONE

    def _step(self) -> bool:
        """One step and what follows from it; True when the run shall stop here."""
        simulation = self.simulation
        bound = simulation.bound()
        if self.plan.fixed_dt:
            self._warn_if_too_long(bound)
            bound = self.plan.fixed_dt
        dt, lands = next_step(simulation.time, self.plan.times[self.frame], bound)
        done, before = simulation.step + 1 - self.first_step, simulation.time
        stop, due = simulation.advance(dt, self.requests.flags(done))
        if lands:
            simulation.time = float(self.plan.times[self.frame])
            self._write_frame()
        self.probes.after_step(before)
        for listener in self.options.listeners:
            listener(simulation)
        every = self.scene.output.checkpoint_steps
        if stop and self.frame < len(self.plan.times):
            return True
        if due or (every and simulation.step % every == 0):
            self._checkpoint()
        return False

    def _warn_if_too_long(self, bound: float) -> None:
        """Once: the fixed step was stable at the start, and no longer is."""
        if self.plan.fixed_dt > bound and not self.warned:
            self.warned = True
            log.warning(
                "step %d: time.dt = %.4g s is above the stable step of the present state, %.4g s",
                self.simulation.step, self.plan.fixed_dt, bound,
            )  # fmt: skip

    def _blew_up(self, said: str) -> int:
        """Say what happened, and write the state as it is for a look at it."""
        if self.options.folder is None:
            log.error("blow-up: %s", said)
            return BLEW_UP
        simulation, folder = self.simulation, self.options.folder / layout.BLOWUP
        ids, fields = frame_rows(simulation, self.scene.output.fields)
        frames = Frames(folder, self.ranks, self.plan.particles)
        path = frames.write(0, simulation.time, simulation.step, ids, fields)
        log.error("blow-up: %s; frames and checkpoints are whole, this state is in %s", said, path)
        return BLEW_UP

    def _write_frame(self) -> None:
        simulation = self.simulation
        self.latest = ledger(simulation)
        if self.options.folder is not None:
            ids, fields = frame_rows(simulation, self.scene.output.fields)
            self.frames.write(self.frame, simulation.time, simulation.step, ids, fields)
            self.ledger.append(self.latest)
        for watcher in self.options.watchers:
            watcher(self)
        self.frame += 1
        self._mark("write")

    def _checkpoint(self) -> None:
        if self.options.folder is None:
            return
        state = save(self.simulation)
        state["attrs"] |= {
            "frame": self.frame,
            "scene_text": self.scene.text,
            "overrides": list(self.scene.overrides),
            "scene": self.scene.resolved(),
            "plan": describe(self.scene, self.plan, ranks=1).splitlines(),
            "versions": versions(),
        }
        path = checkpoint.write(self.checkpoints, self.ranks, state)
        log.info(
            "checkpoint %s at step %d, %.6g s", path, self.simulation.step, self.simulation.time
        )
        self.requests.checkpointed()
        self._mark("write")

    def _mark(self, stage: str) -> None:
        if self.simulation.clock is not None:
            self.simulation.clock(stage)


def start(scene: Scene, ranks: Alone, options: Options) -> Run:
    """Prepare, plan and set up a run. Raises SceneError, StoreError, CheckpointError, Mismatch."""
    known = prepare(scene, ranks, options.folder)
    return Run(scene, plan_for(scene, known), known, ranks, options)


def versions() -> dict[str, str]:
    """What made the file."""
    found = {"python": platform.python_version()}
    for name in ("vgmpi", "numpy", "numba", "h5py", "mpi4py"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        found["commit"] = subprocess.run(
            command, capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        found["commit"] = "unknown"
    return found
