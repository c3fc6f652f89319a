"""Check of what a model can step of a scene file."""

from __future__ import annotations

from datamodules.generate.scene_file import SceneFile
from fluidsnet.errors import UserError


def check_steppable(scene: SceneFile) -> None:
    """Check that a model can step what a scene file describes.

    Raises:
        UserError: It has parts that models do not know, or solids whose motion is not known.
    """
    if found := scene.refusals():
        raise UserError(
            f"{scene.path}: the scene has {', '.join(found)}, which no model steps; only scenes of "
            "one fluid with static rigid bodies are simulated."
        )
    if missing := scene.missing_files():
        raise UserError(
            f"{scene.path}: the file {missing[0]} is missing, which the scene names; copy it there."
        )
    if any(body.get("isAnimated") for body in scene.section("RigidBodies")):
        raise UserError(
            f"{scene.path}: the scene has an animated rigid body, whose motion is not in the file; "
            "simulate it with `fluidsnet generate --scene-file … --run-script` and start from its "
            "data file, which has the motion, or set isAnimated to false to let the body rest."
        )
    if scene.script is not None:
        raise UserError(
            f"{scene.path}: the scene runs the Python script {scene.script}, which only the solver "
            "can run; remove scriptFile from the section Configuration to simulate without it."
        )
