"""Model: a network with the integrator and walls that turn its output into a step."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, final

import torch
from torch import Tensor, nn

from fluidsnet.errors import UserError
from fluidsnet.features.global_feature import GlobalVector
from fluidsnet.features.input import InputFeature, ParticleState
from fluidsnet.features.local import LocalFeature, NeighborMean
from fluidsnet.features.scene_inputs import SceneInputs
from fluidsnet.features.voxel import GridShape
from fluidsnet.integrator import Euler, Integrator
from fluidsnet.loss import mean_square
from fluidsnet.neighbors import Auto, NeighborSearch
from fluidsnet.network import GlobalFeatureFactory, Network
from fluidsnet.noise import StartNoise
from fluidsnet.particles import Particles, Transitions
from fluidsnet.periodic import wrapped
from fluidsnet.priors import FreeFall, Guess, Prior
from fluidsnet.rng import preserve_rng_state
from fluidsnet.scene import Scene
from fluidsnet.scene_checks import check_scenes
from fluidsnet.statistics import Residuals, Statistics
from fluidsnet.target import Target, VelocityTarget
from fluidsnet.walls import OpenWalls, Walls


@final
class Model(nn.Module):
    """One step in time of the fluid particles, composed from blocks.

    The first argument and the last two are what the data need; the others are the blocks, and
    `BLOCKS` has their names.

    Args:
        grid_shape: Number of cells of the background grid along x, y and z.
        neighbors: Neighbor search; `Auto` by default.
        inputs: Input feature (paper, section 4.2); `ParticleState` by default.
        local: Local feature (section 4.3); `NeighborMean` by default.
        global_feature: Builds the global feature (sections 4.4 and 4.5); `GlobalVector` by
            default.
        target: Quantity that the head predicts (section 4.2); `VelocityTarget` by default.
        integrator: Time integration (section 4.6); `Euler` by default.
        walls: Condition at the border of the domain; `OpenWalls` by default.
        head: Widths of the head's hidden layers (Table 1: 32, 16, 8).
        noise: Noise on the states that are trained on; none by default.
        prior: Step that the network corrects; `FreeFall` by default.
        dimension: Dimensions of the scenes, 2 or 3.
        varying: Values of the scene that vary between the training simulations, of
            `fluidsnet.scene.VALUES`. Those that the prior does not know are an input.

    Raises:
        UserError: The integrator needs a displacement and the target gives none, or a block needs
            neighbors and columns of a prior that has none.
    """

    time_step: Tensor

    def __init__(
        self,
        grid_shape: GridShape,
        neighbors: NeighborSearch | None = None,
        inputs: InputFeature | None = None,
        local: LocalFeature | None = None,
        global_feature: GlobalFeatureFactory | None = None,
        target: Target | None = None,
        integrator: Integrator | None = None,
        walls: Walls | None = None,
        head: Sequence[int] = (32, 16, 8),
        noise: StartNoise | None = None,
        prior: Prior | None = None,
        dimension: int = 3,
        varying: Sequence[str] = (),
    ) -> None:
        super().__init__()
        # Blocks that the network builds; a twin builds its own from the same recipe.
        self._recipes = {"global_feature": global_feature or GlobalVector, "head": head}
        self.varying = tuple(varying)
        self.prior = prior or FreeFall()
        inputs, local = inputs or ParticleState(), local or NeighborMean()
        target = target or VelocityTarget()
        used = target.reads_guess or inputs.reads_guess or local.at_guess
        known = self.prior.knows if used else frozenset()
        self.network = Network(
            grid_shape=grid_shape,
            neighbors=neighbors or Auto(),
            inputs=inputs,
            local=local,
            global_feature=global_feature or GlobalVector,
            target=target,
            head=head,
            scene_inputs=SceneInputs([name for name in self.varying if name not in known]),
            dimension=dimension,
        )
        self.integrator = integrator or Euler()
        self.walls = walls or OpenWalls()
        self.noise = noise
        # Part of the checkpoint: a network is valid for the time step it was trained at.
        step = torch.tensor(self.network.target.time_step, dtype=torch.float64)
        self.register_buffer("time_step", step)
        if self.integrator.needs_displacement and not self.network.target.gives_displacement:
            raise UserError(
                f"The integrator {type(self.integrator).__name__} needs a target that predicts "
                f"a displacement, and {type(self.network.target).__name__} does not; use "
                "DisplacementTarget, or the integrator Euler or Trapezoid."
            )
        if self.network.reads_description and not self.prior.describes:
            raise UserError(
                f"The inputs {type(self.network.inputs).__name__} and local feature "
                f"{type(self.network.local).__name__} need a prior that knows neighbors and "
                f"pressure, and {type(self.prior).__name__} does not; set prior to PressureStep."
            )

    def set_statistics(self, statistics: Statistics, time_step: float) -> None:
        """Set the normalization and the time step (s) from the training split."""
        self.network.set_statistics(statistics)
        if self.noise is not None:
            self.noise.set_statistics(statistics)
        self.time_step.fill_(time_step)

    def set_residuals(self, residuals: Residuals) -> None:
        """Set the normalization by what the prior leaves in the training split."""
        self.network.set_residuals(residuals)
        if self.noise is not None:
            self.noise.set_residuals(residuals)

    @property
    def is_trained(self) -> bool:
        """Return whether the model can be used: it was trained, or has no weights to train."""
        return bool(self.time_step != 0) or self.network.target.width == 0

    def check_trainable(self) -> None:
        """Check that there is a network to train.

        Raises:
            UserError: The model is its prior alone.
        """
        if self.network.target.width == 0:
            raise UserError(
                f"The prior {type(self.prior).__name__} alone has no weights to train: run "
                "`fluidsnet test` or `predict` with this config, or choose another target, such as "
                "DisplacementTarget."
            )

    def guess(self, particles: Particles) -> Guess:
        """Return the prior's step, described as far as the network needs it.

        Where nothing reads it, as in the paper's network, it is not computed: the state itself.
        """
        if not self.network.reads_guess:
            return Guess(particles.position, particles.velocity)
        return self.prior.guess(particles, self.network.reads_description)

    def step(self, particles: Particles, global_feature: Tensor | None = None) -> Particles:
        """Return the predicted state one time step later.

        Args:
            particles: N fluid particles and the solid ones.
            global_feature: (N, width) that replaces the state's own global feature.
        """
        guess = self.guess(particles)
        return self.advance(particles, guess, self.network(particles, guess, global_feature))

    def forward(self, particles: Particles) -> Particles:
        """Return the predicted state one time step later, as `step`."""
        return self.step(particles)

    def check_scenes(self, scenes: Scene) -> None:
        """Check that one model can step frames of all of these scenes.

        Raises:
            UserError: The global feature is bound to a grid, and the domains differ; a block does
                not know periodic axes; or the network was trained in another number of dimensions,
                or at another value of what did not vary.
        """
        check_scenes(self.network, self.prior, scenes)

    def check_time_step(self, time_step: float) -> None:
        """Check that the model is for a time step, s; one without a step of its own takes any.

        Raises:
            UserError: It was trained at another one, or its prior is set for another one.
        """
        trained = float(self.time_step)
        if trained and abs(trained - time_step) > 1e-6 * trained:
            made = "network was trained at" if self.network.target.width else "prior is set for"
            raise UserError(
                f"This {made} a time step of {trained:g} s, and the data are "
                f"stepped by {time_step:g} s; set data.stride so that the two agree."
            )

    def advance(self, particles: Particles, guess: Guess, output: Tensor) -> Particles:
        """Return the next state for a network output: decode, integrate, apply the walls.

        Args:
            particles: State that the output was computed from.
            guess: The prior's step from it.
            output: (N, target.width).
        """
        motion = self.network.target.decode(output, particles, guess)
        return wrapped(self.walls(self.integrator(particles, motion)))

    def loss(self, batch: Transitions, warm_up: int = 0) -> Tensor:
        """Return the mean squared error of the network output over the batch's steps, ().

        Args:
            batch: True states, and more steps than those of the warm-up.
            warm_up: Number of first steps that are taken without gradients and do not count, so
                that the network learns from states that it reaches itself (the pushforward of
                Brandstetter et al. 2022).

        Raises:
            UserError: The batch has no step after the warm-up.
        """
        if warm_up >= len(batch.next_position):
            raise UserError(
                f"The data have samples of {len(batch.next_position)} step(s), and a warm-up takes "
                f"{warm_up}; set data.steps above model.warm_up."
            )
        state = batch.state if self.noise is None else self.noise(batch.state)
        losses = []
        true = zip(batch.next_position, batch.next_velocity, strict=True)
        for step, (position, velocity) in enumerate(true, start=1):
            if step <= warm_up:
                with torch.no_grad():
                    state = self.step(state)
            else:
                guess = self.guess(state)
                output = self.network(state, guess)
                expected = self.network.target.encode(state, guess, position, velocity)
                losses.append(mean_square(output, expected))
                if step < len(batch.next_position):
                    state = self.advance(state, guess, output)
            if batch.solids is not None and step < len(batch.next_position):
                state = state.with_solids(*batch.solids[step])
        return torch.stack(losses).mean()

    def blocks(self) -> dict[str, Any]:
        """Return the blocks as built, by the names of the constructor's arguments."""
        return {
            name: getattr(self if hasattr(self, name) else self.network, name) for name in BLOCKS
        }

    def twin(
        self, changes: Mapping[str, Any] | None = None, varying: Sequence[str] | None = None
    ) -> Model:
        """Build a model with blocks of its own that equal this one's except for changes.

        Weights whose names and shapes agree are equal; the others are initialized without a
        change to the random numbers that follow.

        Args:
            changes: Blocks by their names.
            varying: Values of the scene that vary; by default the same.
        """
        blocks = {name: block for name, block in self.blocks().items() if name not in self._recipes}
        with preserve_rng_state():
            twin = Model(
                self.network.grid_shape,
                dimension=self.network.dimension,
                varying=self.varying if varying is None else varying,
                **{**deepcopy(blocks), **self._recipes, **(changes or {})},
            )
        own, source = twin.state_dict(), self.state_dict()
        shared = [name for name in own if name in source and own[name].shape == source[name].shape]
        twin.load_state_dict({name: source[name] for name in shared}, strict=False)
        return twin


#: Names of the blocks.
BLOCKS = tuple(inspect.signature(Model).parameters)[1:-2]
