"""Coarse SPH pressure step: a few substeps of DFSPH with few sweeps and few searches."""

from __future__ import annotations

import math
from typing import final

from torch import Tensor
from torch.profiler import record_function

from fluidsnet.cache import TensorCache
from fluidsnet.errors import UserError
from fluidsnet.kernels import use_kernel
from fluidsnet.kernels.columns import as_array
from fluidsnet.kernels.pressure_step import Boxes, Numbers
from fluidsnet.neighbors.auto import Auto
from fluidsnet.particles import Particles
from fluidsnet.priors.box import Box
from fluidsnet.priors.columns import join_columns
from fluidsnet.priors.compiled_step import CompiledStep
from fluidsnet.priors.edges import Edges, Gradients
from fluidsnet.priors.outcome import Outcome
from fluidsnet.priors.prior import Guess, Prior
from fluidsnet.scene import Scene
from fluidsnet.sph import NEIGHBORS, solid_volumes, spline_height

#: Greatest ν·h/R² at which the explicit viscosity is stable, for a substep h and radius R.
VISCOUS_LIMIT = 0.55


@final
class PressureStep(Prior):
    r"""DFSPH (Bender and Koschier 2017) with few substeps and sweeps, compactly.

    Neighbors are searched once or twice a step, at the place :math:`x + ½t·v` in the middle of the
    time t of a search. In each substep h the gradients :math:`V_j ∇W_{ij}` are taken at
    :math:`x + bh·v`, and then, in the order of SPlisHSPlasH,

    1. pressures reduce the divergence. A sweep is :math:`p_i ← \max(p_i + ω α_i D_i v, 0)` and
       :math:`v_i ← v_i - \sum_j V_j ∇W_{ij} (Δp_i + Δp_j)`, with :math:`α_i = 1 / (|\sum_j V_j
       ∇W|^2 + \sum_j |V ∇W|^2 + 0.01/r^2)`;
    2. viscosity and gravity act: :math:`v_i ← v_i + 2(d + 2)νh \sum_j \frac{V}{ρ_j/ρ_0}
       \frac{v_{ij}·x_{ij}}{x_{ij}^2 + 0.01 r^2} ∇W_{ij} + h·g`; then other pressures reduce
       divergence and excess density, :math:`D_i v + (ρ_i/ρ_0 - 1) / h`, in the same way. Each phase
       starts from its own share of its pressure in the last substep;
    3. :math:`x ← x + h((1 - a) v_0 + a v)`, with a = (m + 1) / 2m, which is the displacement of m
       steps of symplectic Euler under a constant force; particles stop at the walls.

    :math:`D_i v = \sum_j V_j (v_i - v_j)·∇W_{ij}` is the rate of ρ/ρ₀; d is 3, or 2 in two
    dimensions; r is the support radius, W the cubic spline, V = (2R)^d the volume of a particle of
    radius R, and V_j that of a solid, 1/ΣW over the solids around it (Akinci et al. 2012). The push
    is antisymmetric, so it conserves momentum. Solids that move go straight on within a step.

    Args:
        searches: Number of neighbor searches in a step.
        substeps: Number of substeps for each search; at a step of 20 ms and a particle radius of
            25 mm, two searches of three substeps.
        sweeps: Sweeps over density in a substep.
        divergence_sweeps: Sweeps over divergence in a substep; none for data of IISPH, which
            solves for density alone.
        solver_step: Time step of the solver that made the data, s, which sets m.
        relaxation: ω of the sweeps.
        warm_start: Share of the pressure of the sweeps over density that the next substep starts
            from.
        divergence_warm_start: The same of the sweeps over divergence.
        clearance: Distance from the walls at which particles stop, particle radii.
        ahead: b, the share of a substep after which gradients are taken.

    Raises:
        UserError: An argument is out of range.
    """

    describes = True
    knows = frozenset({"gravity", "viscosity"})

    def __init__(
        self,
        searches: int = 2,
        substeps: int = 3,
        sweeps: int = 2,
        divergence_sweeps: int = 1,
        solver_step: float = 0.0025,
        relaxation: float = 0.6,
        warm_start: float = 0.5,
        divergence_warm_start: float = 0.5,
        clearance: float = 0.9,
        ahead: float = 0.2,
    ) -> None:
        super().__init__()
        for name, value, least in (
            ("searches", searches, 1),
            ("substeps", substeps, 1),
            ("sweeps", sweeps, 0),
            ("divergence_sweeps", divergence_sweeps, 0),
            ("relaxation", relaxation, 0),
            ("warm_start", warm_start, 0),
            ("divergence_warm_start", divergence_warm_start, 0),
            ("clearance", clearance, 0),
            ("ahead", ahead, 0),
        ):
            if not least <= value < math.inf:
                raise UserError(f"PressureStep: {name} is {value}; set at least {least}.")
        if not 0 < solver_step < math.inf:
            raise UserError(f"PressureStep: solver_step is {solver_step}; set it above zero, in s.")
        self.searches, self.substeps = searches, substeps
        self.sweeps, self.divergence_sweeps = sweeps, divergence_sweeps
        self.solver_step, self.relaxation = solver_step, relaxation
        self.warm_start, self.divergence_warm_start = warm_start, divergence_warm_start
        self.clearance, self.ahead = clearance, ahead
        self._search = Auto(NEIGHBORS)
        self._volumes: TensorCache[Tensor] = TensorCache()
        self._compiled = CompiledStep()

    def mean_weight(self, substep: float) -> float:
        """Return a, the weight of the new velocity in the displacement of a substep (s)."""
        steps = max(substep / self.solver_step, 1.0)
        return (steps + 1) / (2 * steps)

    def doubts(self, scenes: Scene) -> list[str]:
        substep = scenes.time_step / (self.searches * self.substeps)
        most = VISCOUS_LIMIT * scenes.particle_radius**2 / substep
        told = [
            f"{name} has a viscosity of {value:g}, and steps of {1000 * substep:.3g} ms with "
            f"particles of {scenes.particle_radius:g} m are stable up to {most:.3g}; raise the "
            "prior's substeps."
            for name, value in zip(scenes.names, scenes.viscosity.tolist(), strict=True)
            if value > most
        ]
        return told[:1]

    def forward(self, particles: Particles, described: bool = False) -> Guess:
        advance = self._reference
        if use_kernel(self, particles.position, particles.velocity, particles.solid_position):
            advance = self._kernel
        zero = particles.position.new_zeros(len(particles))
        with record_function("prior"):
            outcome = first = advance(particles, (zero, zero))
            searched = particles.scene.time_step / self.searches
            for _ in range(self.searches - 1):
                outcome = advance(outcome.state.after_drift(searched), outcome.pressures)
            position, velocity = outcome.state.position, outcome.state.velocity
            if not described:
                return Guess(position, velocity)
            neighbors, description = outcome.describe()
            columns = join_columns(
                description,
                outcome.density,
                outcome.surface,
                (first.rates[0], outcome.rates[1]),
                outcome.pressures,
                particles.scene.time_step,
                particles.scene.support_radius,
            )
        return Guess(position, velocity, neighbors, columns)

    def _kernel(self, particles: Particles, pressures: tuple[Tensor, Tensor]) -> Outcome:
        """Return the outcome of the substeps of one search, by the kernel."""
        scene = particles.scene
        lower, upper = scene.room(self.clearance)
        substep = scene.time_step / (self.searches * self.substeps)
        numbers = Numbers(
            radius=scene.support_radius,
            height=spline_height(scene.support_radius, scene.dimension),
            volume=scene.particle_volume,
            viscous=_viscous(scene),
            substep=substep,
            mean_weight=self.mean_weight(substep),
            ahead=self.ahead,
            sweeps=self.sweeps,
            divergence_sweeps=self.divergence_sweeps,
            relaxation=self.relaxation,
            warm_start=self.warm_start,
            divergence_warm_start=self.divergence_warm_start,
        )
        boxes = Boxes(*map(as_array, (lower, upper, scene.gravity, scene.viscosity)))
        return self._compiled(
            particles, self._middle(particles), pressures, boxes, numbers, self.substeps
        )

    def _middle(self, particles: Particles) -> Particles:
        """Return the particles in the middle of the substeps of one search."""
        half = particles.scene.time_step / (2 * self.searches)
        box = Box.of(particles, self.clearance)
        place = box.inside(particles.position + half * particles.velocity)
        return particles.moved(place, particles.velocity).after_drift(half)

    def _reference(self, particles: Particles, pressures: tuple[Tensor, Tensor]) -> Outcome:
        """Return the outcome of the substeps of one search, in torch."""
        scene = particles.scene
        box = Box.of(particles, self.clearance)
        searched = self._middle(particles)
        solids = self._volumes.get(
            (particles.solid_position, particles.solid_frame),
            (scene.support_radius, particles.frames),
            lambda position, frame: solid_volumes(particles),
        )
        edges = Edges.of(searched, self._search(searched), solids)
        step = scene.time_step / (self.searches * self.substeps)
        weight = self.mean_weight(step)
        gravity = particles.per_particle(scene.gravity)
        viscosity = _viscous(scene) * step * particles.per_particle(scene.viscosity[:, None])
        position, velocity = particles.position, particles.velocity
        upkeep, pressure = pressures
        divergence = None
        for substep in range(self.substeps):
            before = velocity
            time = (substep + self.ahead - self.substeps / 2) * step
            at = edges.at(box.inside(position + self.ahead * step * velocity), time)
            divergence = at.divergence(velocity) if divergence is None else divergence
            upkeep = self.divergence_warm_start * upkeep
            pressure = self.warm_start * pressure
            velocity = velocity - at.push(upkeep)
            for _ in range(self.divergence_sweeps):
                raised = self._raised(at, upkeep, at.divergence(velocity))
                velocity = velocity - at.push(raised - upkeep)
                upkeep = raised
            velocity = velocity + viscosity * at.viscous(velocity)
            velocity = velocity + step * gravity - at.push(pressure)
            for _ in range(self.sweeps):
                rate = at.divergence(velocity) + (at.density - 1) / step
                raised = self._raised(at, pressure, rate)
                velocity = velocity - at.push(raised - pressure)
                pressure = raised
            position = position + step * ((1 - weight) * before + weight * velocity)
            position, velocity = box.stop(position, velocity)
        assert divergence is not None
        return Outcome(
            state=particles.moved(position, velocity),
            pressures=(upkeep, pressure),
            rates=(divergence, at.divergence(velocity)),
            density=at.density,
            surface=edges.sum(at.gradient),
            describe=lambda: (edges.wet_edges(), edges.describe(position)),
        )

    def _raised(self, at: Gradients, pressure: Tensor, rate: Tensor) -> Tensor:
        return (pressure + self.relaxation * at.stiffness * rate).clamp_min(0)


def _viscous(scene: Scene) -> float:
    """Return 2(d + 2), the factor of the viscosity in d dimensions (Monaghan 2005)."""
    return 2.0 * (scene.dimension + 2)
