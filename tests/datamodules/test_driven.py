"""Scenes with a solid that moves, made by the real solver and rolled out by the prior."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader

from datamodules import SPHDataModule, read_motion, read_state
from datamodules.generate.dataset import generate
from datamodules.generate.driven import StirredTank, WaveMaker
from datamodules.generate.moving_solids import describe_solids, solids_from
from datamodules.generate.recipe import Recipe
from datamodules.generate.scenes import SceneKind
from datamodules.inspection import summarize
from fluidsnet import load
from fluidsnet.calibration import measure_residuals
from fluidsnet.errors import UserError
from fluidsnet.export.vtkhdf import read_frame
from fluidsnet.features import ContinuousConvolutions, NoGlobalFeature, PriorState
from fluidsnet.integrator import Displacement
from fluidsnet.main import main
from fluidsnet.model import Model
from fluidsnet.particles import SolidStates
from fluidsnet.priors import PressureStep
from fluidsnet.rollout import rollout
from fluidsnet.target import DisplacementTarget

CONFIGS = Path(__file__).parents[2] / "configs"
PRIOR = CONFIGS / "model" / "prior.yaml"
RADIUS, FRAMES = 0.04, 13
KINDS: dict[str, SceneKind] = {
    "stirred": StirredTank(domain=(1.0, 0.8, 1.0), paddle=(0.5, 0.6), speed=(3.0, 4.0)),
    "wave": WaveMaker(domain=(1.6, 0.8, 0.5), stroke=(0.1, 0.15), period=(0.5, 0.6)),
}


def recipe(kind: str) -> Recipe:
    return Recipe(
        scene=KINDS[kind], particle_radius=RADIUS, train=0, val=0, test=1, frames=FRAMES,
        frame_interval=0.02, solver="DFSPH",
    )  # fmt: skip


@pytest.fixture(scope="module", params=KINDS)
def driven(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, real_solver: None
) -> tuple[str, Path]:
    root = tmp_path_factory.mktemp(request.param)
    assert generate(recipe(request.param), root, processes=1) == []
    return request.param, root / "test.h5"


def read(path: Path) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.bool_]]:
    """Return the data sets of the simulation, and which solids move."""
    names = ("position", "velocity", "solid_position", "solid_velocity", "time")
    with h5py.File(path) as file:
        values = {name: file[f"00000/{name}"][()].astype(np.float64) for name in names}
    return values, np.ptp(values["solid_position"], axis=0).max(axis=1) > 1e-4


def test_the_solver_moves_the_solid_as_it_was_drawn(driven: tuple[str, Path]) -> None:
    kind, path = driven
    ((solid,),) = (scene.solids for scene in recipe(kind).starts().values())
    values, moves = read(path)
    place, velocity, time = values["solid_position"], values["solid_velocity"], values["time"]
    assert 0 < moves.sum() < len(moves)
    assert not velocity[:, ~moves].any()
    start = place[0, moves]
    half = np.array(solid.edges) / 2 + 1e-3
    assert (np.abs(start - np.array(solid.center)) <= half).all()
    for frame in range(1, FRAMES):
        if kind == "stirred":
            angle = solid.spin[1] * time[frame]
            x, z = (start[:, axis] - solid.center[axis] for axis in (0, 2))
            turned = np.stack(
                [x * np.cos(angle) + z * np.sin(angle), z * np.cos(angle) - x * np.sin(angle)], 1
            )
            expected = start.copy()
            expected[:, [0, 2]] = turned + np.array(solid.center)[[0, 2]]
            speed = np.cross(solid.spin, place[frame, moves] - np.array(solid.center))
        else:
            way = np.array(solid.swing) * (1 - np.cos(solid.frequency * time[frame]))
            expected = start + way
            speed = np.broadcast_to(solid.velocity(time[frame] - 0.0025), start.shape)
        # The solver moves it by Euler steps of 2.5 ms.
        np.testing.assert_allclose(place[frame, moves], expected, atol=2.5e-3)
        np.testing.assert_allclose(velocity[frame, moves], speed, atol=0.03)


def test_no_fluid_starts_in_the_solid_or_close_to_it(driven: tuple[str, Path]) -> None:
    values, moves = read(driven[1])
    offsets = values["position"][0][:, None] - values["solid_position"][0][None, moves]
    assert np.linalg.norm(offsets, axis=-1).min() > 2 * RADIUS
    assert "move" in summarize(driven[1]).text


def test_the_prior_feels_the_solid_move(driven: tuple[str, Path]) -> None:
    _, path = driven
    model = load(PRIOR)
    frame, steps = 3, 6
    start, solids = read_state(path, 0.02, frame), read_motion(path, 0.02, frame)
    true = read_state(path, 0.02, frame + steps)
    assert start.solids_move and solids is not None
    with pytest.raises(UserError, match=r"solids of this scene move: give their motion"):
        next(rollout(model, start, steps))
    *_, end = rollout(model, start, steps, solids)
    torch.testing.assert_close(end.solid_position, true.solid_position)
    # The same rollout beside a solid that stays where it started.
    still = start.moved(start.position, start.velocity)
    for _ in range(steps):
        still = model.step(still.with_solids(start.solid_position, 0 * start.solid_velocity))
    error, without = (
        float((state.position - true.position).norm(dim=1).mean()) for state in (end, still)
    )
    assert error < 0.004 and error < 0.6 * without


def test_predict_writes_the_solid_beside_the_fluid(
    driven: tuple[str, Path], tmp_path: Path
) -> None:
    shutil.copy(driven[1], tmp_path / "test.h5")
    configs = (CONFIGS / "trainer.yaml", PRIOR, CONFIGS / "data" / "stirred_tank.yaml")
    logger = "--trainer.logger.init_args"
    main(
        [
            *("predict", *(f"--config={config}" for config in configs)),
            *(f"--data.init_args.root={tmp_path}", f"--data.init_args.voxel_size={4 * RADIUS}"),
            *(f"{logger}.save_dir={tmp_path}", f"{logger}.name=run", f"{logger}.version="),
            *("--data.init_args.rollout_steps=4", "--data.init_args.workers=0"),
        ]
    )
    values, moves = read(driven[1])
    (folder,) = (tmp_path / "run" / "results").iterdir()
    path = folder / "rollouts" / "00000_solids.vtkhdf"
    for step in (0, 4):
        position, data = read_frame(path, step)
        np.testing.assert_allclose(position, values["solid_position"][step, moves], atol=1e-6)
        np.testing.assert_allclose(
            data["velocity"], values["solid_velocity"][step, moves], atol=1e-6
        )
    # The reader of ParaView reads it, too.
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    reader.SetStep(4)
    reader.Update()
    points = vtk_to_numpy(reader.GetOutput().GetPoints().GetData())
    np.testing.assert_allclose(points, values["solid_position"][4, moves], atol=1e-6)
    assert (folder / "rollout.png").stat().st_size > 10_000


def test_a_network_trains_over_steps_beside_the_solid(
    driven: tuple[str, Path], tmp_path: Path
) -> None:
    for split in ("train", "val"):
        shutil.copy(driven[1], tmp_path / f"{split}.h5")
    source = SPHDataModule(tmp_path, voxel_size=4 * RADIUS, steps=2, batch_size=2)
    source.setup("fit")
    torch.manual_seed(0)
    model = Model(
        source.grid_shape, prior=PressureStep(), inputs=PriorState(),
        local=ContinuousConvolutions(8, 4), global_feature=NoGlobalFeature,
        target=DisplacementTarget(), integrator=Displacement(),
    )  # fmt: skip
    model.set_statistics(source.statistics, source.time_step)
    model.set_residuals(measure_residuals(model.prior, source.calibration_samples(4)))
    batch = next(iter(source.train_dataloader()))
    assert batch.solids is not None and batch.state.solids_move
    assert len(batch.solids[1][0]) == len(batch.state.solid_position)
    loss = model.loss(batch)
    loss.backward()
    assert all(it.grad is not None and it.grad.isfinite().all() for it in model.parameters())
    # The second step is beside the solid as it is then.
    stays = SolidStates(
        batch.state.solid_position.expand(2, -1, -1),
        0 * batch.state.solid_velocity.expand(2, -1, -1),
    )
    assert abs(float((model.loss(replace(batch, solids=stays)) / loss).detach()) - 1) > 1e-4


def test_solids_come_back_from_json() -> None:
    for kind in KINDS:
        for scene in recipe(kind).starts().values():
            assert solids_from(describe_solids(scene.solids)) == scene.solids


@pytest.mark.parametrize(
    ("kind", "arguments", "words"),
    [
        (StirredTank, {"paddle": (0.5, 0.9)}, "paddle of StirredTank is .* at most 0.8"),
        (StirredTank, {"speed": (0.0, 1.0)}, "speed of StirredTank is .* above 0"),
        (WaveMaker, {"stroke": (0.2, 0.1)}, "stroke of WaveMaker is"),
        (WaveMaker, {"period": (0.0, 0.1)}, "period of WaveMaker is"),
    ],
)
def test_ranges_that_cannot_be_used(
    kind: type[StirredTank], arguments: dict[str, tuple[float, float]], words: str
) -> None:
    with pytest.raises(UserError, match=words):
        kind(**arguments)
