"""Recipe: settings of a generated data set."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datamodules.generate.bodies import Vector
from datamodules.generate.job import (
    FURTHER_PARAMETERS,
    PARAMETERS,
    SOLVER_STEPS,
    DrawnJob,
    Job,
    SolverName,
)
from datamodules.generate.scenes import DrawnScene, SceneKind
from datamodules.generate.symmetry import Symmetries
from datamodules.schema import SPLITS, Header, SceneAttributes
from fluidsnet.errors import UserError

#: Most particles that fit into the box of a scene; the solver counts them with 32 bits.
MOST_PARTICLES = 2e9
#: Greatest number of draws for a scene that differs from the others.
_DRAWS = 1000


@dataclass(frozen=True)
class Recipe:
    """Settings that determine a data set.

    Attributes:
        scene: Kind of scene, which draws the fluid and its box.
        particle_radius: Half the spacing of the particles, m.
        train: Number of simulations for training.
        val: Number of simulations for validation.
        test: Number of simulations for the test.
        frames: Stored frames per simulation, the start included.
        frame_interval: Time between stored frames, s; a whole number of solver steps.
        solver_step: Fixed time step of the solver, s; 2.5 ms by default, 0.5 ms for WCSPH.
        solver: IISPH (the paper's), WCSPH, PCISPH or DFSPH.
        seed: Seed of the data set; with split and number it seeds each simulation.
        gravity: Acceleration of gravity, m/s².
        density0: Rest density, kg/m³.
        viscosity: Coefficient of the solver's standard viscosity, where the scene draws none.
        solver_parameters: Parameters of the pressure solver, under SPlisHSPlasH's names.
        scale: Factor on the lengths of the scene; the particles stay as large.
    """

    scene: SceneKind
    particle_radius: float
    train: int
    val: int
    test: int
    frames: int = 1500
    frame_interval: float = 0.0025
    solver_step: float | None = None
    solver: SolverName = "IISPH"
    seed: int = 0
    gravity: Vector = (0.0, -9.81, 0.0)
    density0: float = 1000.0
    viscosity: float = 0.01
    solver_parameters: dict[str, float] | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        if not self.step > 0:
            raise UserError(f"solver_step is {self.step}; it must be above zero.")
        if not all(map(math.isfinite, (self.frame_interval, *self.gravity))):
            raise UserError(
                f"frame_interval is {self.frame_interval}, and gravity {self.gravity}; they must "
                "be finite."
            )
        if self.seed < 0:
            raise UserError(f"seed is {self.seed}; it must be at least 0.")
        ratio = self.frame_interval / self.step
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
            raise UserError(
                f"frame_interval ({self.frame_interval} s) must be a whole number of "
                f"solver steps ({self.step} s)."
            )
        if not self.particle_radius > 0:
            raise UserError(f"particle_radius is {self.particle_radius}; it must be above zero.")
        if not 0 < self.scale < math.inf:
            raise UserError(f"scale is {self.scale}; it must be above zero.")
        for name, least in (("viscosity", 0.0), ("density0", 1e-30)):
            if not least <= getattr(self, name) < math.inf:
                bound = "at least" if least == 0 else "above"
                raise UserError(f"{name} is {getattr(self, name)}; it must be {bound} zero.")
        known = {*PARAMETERS[self.solver], *FURTHER_PARAMETERS}
        for name, value in (self.solver_parameters or {}).items():
            if not 0 <= value < math.inf:
                raise UserError(f"solver_parameters: {name} is {value}; it must be at least zero.")
            if name not in known:
                raise UserError(
                    f"solver_parameters has {name}, which {self.solver} does not know; it knows "
                    f"{', '.join(sorted(known))}."
                )
        for name, least in (("frames", 2), *((split, 0) for split in SPLITS)):
            if getattr(self, name) < least:
                raise UserError(f"{name} is {getattr(self, name)}; it must be at least {least}.")
        if self.train + self.val + self.test == 0:
            raise UserError("train, val and test are all zero; there is nothing to simulate.")

    @property
    def step(self) -> float:
        """Time step of the solver, s: `solver_step`, or the default of the solver."""
        return SOLVER_STEPS[self.solver] if self.solver_step is None else self.solver_step

    @property
    def counts(self) -> dict[str, int]:
        """Number of simulations of each split."""
        return {split: getattr(self, split) for split in SPLITS}

    def description(self) -> str:
        """Return the recipe as JSON text, by which its data set is recognized."""
        scene = {f"scene.{name}": value for name, value in vars(self.scene).items()}
        described = {**vars(self), "scene": type(self.scene).__name__, **scene}
        if self.scale == 1:
            del described["scale"]
        return json.dumps(described, indent=2, default=str, sort_keys=True)

    def jobs(self, folder: Path, threads: int) -> dict[str, Job]:
        """Return the job of each simulation by the name of its file in a folder."""
        return {
            (name := f"{split}-{number:05d}"): self.job(
                split, number, drawn, folder / f"{name}.h5", threads
            )
            for (split, number), drawn in self.starts().items()
        }

    def starts(self) -> dict[tuple[str, int], DrawnScene]:
        """Draw the scene of each simulation, by split and number.

        No two starts are mirror images of each other to within a particle radius, since a test
        on a mirror image of a training simulation would measure memorization. Where the kind of
        scene has no other start left, training may have mirror images, but no copies, of its own.

        Raises:
            UserError: the kind of scene has too few different starts.
        """
        symmetries = Symmetries(self.gravity)
        drawn: dict[tuple[str, int], DrawnScene] = {}
        held_out: list[DrawnScene] = []

        def is_like(others: Iterable[DrawnScene], scene: DrawnScene) -> bool:
            return any(symmetries.alike(scene, other, self.particle_radius) for other in others)

        def is_new(scene: DrawnScene) -> bool:
            return not is_like(drawn.values(), scene)

        def is_mirrored_in_training(scene: DrawnScene) -> bool:
            return scene not in drawn.values() and not is_like(held_out, scene)

        # Test and validation are drawn first, so they do not depend on the size of training.
        for split in reversed(SPLITS):
            held_out, wanted = list(drawn.values()), is_new
            for number in range(getattr(self, split)):
                random = np.random.default_rng(self._entropy(split, number))
                scene = self._draw(random, wanted)
                if scene is None and split == "train" and wanted is is_new:
                    wanted = is_mirrored_in_training
                    scene = self._draw(random, wanted)
                if scene is None:
                    raise UserError(
                        f"{type(self.scene).__name__} draws too few scenes that are no mirror "
                        f"images of each other: {len(drawn)} of "
                        f"{self.train + self.val + self.test} were found; use smaller "
                        "particles, wider ranges or fewer simulations."
                    )
                drawn[split, number] = scene
        return drawn

    def _draw(
        self, random: np.random.Generator, wanted: Callable[[DrawnScene], bool]
    ) -> DrawnScene | None:
        """Draw scenes until one is accepted; return None after too many draws."""
        kind = self.scene if self.scale == 1 else self.scene.scaled(self.scale)
        draws = (kind.sample(random, self.particle_radius) for _ in range(_DRAWS))
        return next(filter(wanted, draws), None)

    def _entropy(self, split: str, number: int) -> list[int]:
        return [self.seed, SPLITS.index(split), number]

    def job(
        self, split: str, number: int, drawn: DrawnScene, output: Path, threads: int
    ) -> DrawnJob:
        """Return the job of a simulation, given its start from `starts`."""
        steps_per_frame = round(self.frame_interval / self.step)
        header = Header(
            scene=type(self.scene).__name__,
            solver=self.solver,
            solver_version="",
            solver_parameters={},
            particle_radius=self.particle_radius,
            support_radius=4 * self.particle_radius,
            dt=steps_per_frame * self.step,
        )
        width, height, depth = drawn.domain
        particles = math.prod(edge / (2 * self.particle_radius) for edge in drawn.domain)
        if particles > MOST_PARTICLES:
            raise UserError(
                f"particle_radius is {self.particle_radius:g} m, by which up to {particles:.2g} "
                f"particles fit into a box of {width:g} x {height:g} x {depth:g} m; the solver "
                f"takes up to {MOST_PARTICLES:.0e}. Set larger particles."
            )
        # In two dimensions the plane of the fluid halves the box.
        front = depth / 2 if drawn.dimension == 2 else 0.0
        scene = SceneAttributes(
            domain_lower=(0.0, 0.0, -front),
            domain_upper=(width, height, depth - front),
            gravity=self.gravity if drawn.gravity is None else drawn.gravity,
            density0=self.density0,
            viscosity=self.viscosity if drawn.viscosity is None else drawn.viscosity,
            dimension=drawn.dimension,
        )
        return DrawnJob(
            output=str(output),
            header=header,
            scene=scene,
            solver_step=self.step,
            steps_per_frame=steps_per_frame,
            frames=self.frames,
            entropy=self._entropy(split, number),
            bodies=drawn.bodies,
            solids=drawn.solids,
            threads=threads,
            parameters={**PARAMETERS[self.solver], **(self.solver_parameters or {})},
        )
