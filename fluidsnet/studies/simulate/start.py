"""Start of a simulation: a frame of a data file, a random scene, or a scene file."""

from __future__ import annotations

import tempfile
from argparse import ArgumentError
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, final

from jsonargparse import ArgumentParser

from datamodules.generate.job import DrawnJob
from datamodules.generate.recipe import Recipe
from datamodules.generate.scene_file import SceneFile
from datamodules.generate.scene_file_job import SceneFileJob
from datamodules.generate.scene_file_plan import SceneFilePlan
from datamodules.generate.solid_course import SolidCourse
from datamodules.generate.start import lattice_start, solver_is_installed, solver_start
from datamodules.reader import FrameReader, read_motion
from fluidsnet.errors import UserError
from fluidsnet.particles import Particles, SolidMotion
from fluidsnet.studies.machine import cores
from fluidsnet.studies.simulate.steppable import check_steppable

#: What samples fluid and walls: the solver where it is installed, the solver, or our lattices.
Sampling = Literal["auto", "solver", "lattice"]


@final
@dataclass(frozen=True)
class Start:
    """State to simulate from.

    Attributes:
        name: Name of the scene, for files and pictures.
        state: First state, with the time step of the model.
        origin: Sentence on where it comes from.
        solids: Motion of the solids; None where they rest.
        known_steps: Steps for which the motion of the solids is known; None for any number.
        closed: The scene has walls around it that no particle may leave.
        notes: Sentences on what of the scene the model leaves out.
    """

    name: str
    state: Particles
    origin: str
    solids: SolidMotion | None = None
    known_steps: int | None = None
    closed: bool = True
    notes: tuple[str, ...] = ()


@final
@dataclass(frozen=True)
class SceneChoice:
    """Scene and which of its starts to take.

    Attributes:
        scene: Data file, config of a kind of scene, or scene file of SPlisHSPlasH.
        simulation: Simulation of a data file, or number of a random scene.
        frame: Frame of a data file.
        seed: Seed of random scenes.
        sampling: What samples fluid and walls.
    """

    scene: str
    simulation: str | None = None
    frame: int | None = None
    seed: int | None = None
    sampling: Sampling = "auto"

    def start(self, time_step: float) -> Start:
        """Return the start for steps of a length, s.

        Raises:
            UserError: There is no such scene, an option is not for it, or a model cannot step it.
        """
        kind = Path(self.scene).suffix.lower()
        read: Callable[[float], Start]
        known: tuple[str, ...]
        if kind in (".h5", ".hdf5"):
            read, known = self._of_data_file, ("simulation", "frame")
        elif kind in (".yaml", ".yml"):
            read, known = self._of_recipe, ("simulation", "seed", "sampling")
        else:
            read, known = self._of_scene_file, ("sampling",)
        for name, what in (
            ("simulation", "a data file or a config of random scenes"),
            ("frame", "a data file"),
            ("seed", "a config of random scenes"),
            ("sampling", "a scene that is not simulated yet"),
        ):
            if name not in known and getattr(self, name) not in (None, "auto"):
                raise UserError(f"--{name} is for {what}, and {self.scene} is none; leave it out.")
        return read(time_step)

    def _of_data_file(self, time_step: float) -> Start:
        path, frame = Path(self.scene), self.frame or 0
        reader = FrameReader(path)
        wanted = self.simulation or next(iter(reader.frames))
        name = wanted if wanted in reader.frames else wanted.zfill(5)
        if name not in reader.frames:
            raise UserError(
                f"{path}: there is no simulation {wanted}; it has {', '.join(reader.frames)}."
            )
        count = reader.frames[name]
        if not 0 <= frame < count:
            raise UserError(f"{path}: there is no frame {frame} of /{name}, which has {count}.")
        state = reader.state(name, frame, 1)
        motion, known = None, None
        if state.solids_move:
            motion = read_motion(path, time_step, frame, name)
            known = (count - 1 - frame) // round(time_step / reader.header.dt)
        reader.close()
        return Start(
            name=f"{path.stem}_{name}_{frame}",
            state=_stepped(state, time_step),
            origin=f"frame {frame} of /{name} in {path}",
            solids=motion,
            known_steps=known,
        )

    def _of_recipe(self, time_step: float) -> Start:
        recipe = _recipe(Path(self.scene))
        try:
            number = int(self.simulation or 0)
        except ValueError as error:
            raise UserError(
                f"--simulation is {self.simulation}; a random scene has a number, such as 3."
            ) from error
        if number < 0:
            raise UserError(f"--simulation is {number}; set at least 0.")
        # The test split is drawn first, so these are the scenes of `fluidsnet generate`.
        seed = recipe.seed if self.seed is None else self.seed
        recipe = replace(recipe, train=0, val=0, test=number + 1, seed=seed)
        drawn = recipe.starts()["test", number]
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder) / "start.h5"
            job = recipe.job("test", number, drawn, output, cores())
            state, by = self._sampled(job, time_step)
        course = SolidCourse(job.solids, state.solid_position, time_step) if job.solids else None
        return Start(
            name=f"{Path(self.scene).stem}_{seed}_{number}",
            state=state if course is None else state.with_solids(*course[0]),
            origin=f"random scene {number} of seed {seed} of {self.scene}, sampled by {by}",
            solids=course,
        )

    def _of_scene_file(self, time_step: float) -> Start:
        scene = SceneFile.find(self.scene)
        check_steppable(scene)
        plan = SceneFilePlan(str(scene.path))
        with tempfile.TemporaryDirectory() as folder:
            ((_, job),) = plan.jobs(Path(folder), cores()).items()
            assert isinstance(job, SceneFileJob)
            state, by = self._sampled(job, time_step)
        return Start(
            name=scene.path.stem,
            state=state,
            origin=f"{scene.path}, sampled by {by}",
            closed=any(body.get("isWall") for body in scene.section("RigidBodies")),
            notes=tuple(scene.unknown_methods()),
        )

    def _sampled(self, job: DrawnJob | SceneFileJob, time_step: float) -> tuple[Particles, str]:
        """Return the state of a job and what sampled it."""
        solver = self.sampling == "solver" or (self.sampling == "auto" and solver_is_installed())
        if solver:
            solver_start(job)
        else:
            lattice_start(job)
        reader = FrameReader(Path(job.output))
        state = reader.state("00000", 0, 1)
        reader.close()
        name = Path(self.scene).stem
        state = replace(state, scene=replace(state.scene, names=(name,)))
        if state.solids_move:
            # `SolidCourse` moves them; a file of one frame has no motion.
            state = replace(state, solids_move=False)
        return _stepped(state, time_step), "the solver" if solver else "lattices"


def _stepped(state: Particles, time_step: float) -> Particles:
    """Return a state with the time step of its scene changed, s."""
    return replace(state, scene=replace(state.scene, time_step=time_step))


def _recipe(path: Path) -> Recipe:
    """Read the recipe of a config of `fluidsnet generate`.

    Raises:
        UserError: There is no such file, or it is no such config.
    """
    if not path.is_file():
        raise UserError(
            f"{path}: there is no such file; name a config such as those in configs/scene."
        )
    parser = ArgumentParser(exit_on_error=False)
    parser.add_argument("--config", action="config")
    parser.add_class_arguments(Recipe, "recipe")
    try:
        options = parser.instantiate(parser.parse_args([f"--config={path}"]))
    except (ArgumentError, ValueError, TypeError) as error:
        raise UserError(f"{path}: not a config of `fluidsnet generate`: {error}") from error
    return Recipe(**vars(options.recipe))


def opened(start: Start, seconds: float) -> Start:
    """Return the start of a scene without walls with room for all that can fall or fly.

    Args:
        start: Start; a closed one is returned as it is.
        seconds: Time to simulate.
    """
    if start.closed:
        return start
    scene = start.state.scene
    pull = scene.gravity.norm(dim=1, keepdim=True)
    speed = start.state.velocity.norm(dim=1).max() if len(start.state) else pull.new_zeros(())
    reach = speed * seconds + pull * seconds**2 / 2 + 8 * scene.particle_radius
    reach = reach.expand(-1, 3).clone()
    if scene.dimension == 2:
        reach[:, 2] = 0
    lower, upper = scene.domain_lower - reach, scene.domain_upper + reach
    x, y, z = (upper - lower)[0].tolist()
    wider = replace(scene, domain_lower=lower, domain_upper=upper, edges=((x, y, z),))
    return replace(start, state=replace(start.state, scene=wider))
