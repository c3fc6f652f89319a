"""``fluidsnet simulate``: simulate a scene with a trained model in place of the solver."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from fluidsnet.errors import UserError
from fluidsnet.export.movie import check_movie
from fluidsnet.model import Model
from fluidsnet.models import load
from fluidsnet.studies.simulate.concerns import concerns
from fluidsnet.studies.simulate.options import SimulateOptions, parse_simulate
from fluidsnet.studies.simulate.pictures import draw_movie, draw_picture
from fluidsnet.studies.simulate.rest import DURATION, RestWatch, rest_speed
from fluidsnet.studies.simulate.run import Course, run
from fluidsnet.studies.simulate.start import Start, opened

#: Time step of a model that takes any, s.
_TIME_STEP = 0.02


def simulate_command(arguments: list[str]) -> None:
    """Simulate a scene, write its files, and print where they are.

    Raises:
        UserError: An option cannot be used, the model cannot step the scene, or a particle is no
            longer finite.
        KeyboardInterrupt: Ctrl-C ended the simulation; what was stored is whole.
    """
    options = parse_simulate(arguments)
    if options.movie is not None:
        check_movie(options.movie)
    device = options.torch_device()
    model = load(options.model, device)
    start = opened(options.choice.start(_time_step(model, options)), options.seconds)
    steps = _steps(start, options)
    print(_summary(start, steps, options, str(device)))
    for told in (*start.notes, *concerns(options.model, model, start.state)):
        print(f"WARNING: {told}", file=sys.stderr)
    rest = None
    if options.until_rest:
        rest = RestWatch(options.rest_speed or rest_speed(start.state))
    folder = options.output or Path("runs") / "simulate" / Path(options.model).name
    start = replace(start, state=start.state.to(device))
    course = run(model, start, steps, options.every, folder, rest)
    _tell(course, rest)
    picture = folder / f"{start.name}.png"
    draw_picture(picture, start, course)
    written = [course.path, *([course.solids] if course.solids else []), picture]
    if options.movie is not None and not course.interrupted:
        count = draw_movie(options.movie, start, course)
        print(f"The movie has {count} frames.")
        written.append(options.movie)
    print(f"Written: {', '.join(map(str, written))}.")
    if course.interrupted:
        raise KeyboardInterrupt
    if course.not_finite is not None:
        raise UserError(
            f"a particle is not finite after {course.not_finite:g} s; the states before are in "
            f"{course.path}. Choose a model for such scenes (docs/simulate.md)."
        )


def _time_step(model: Model, options: SimulateOptions) -> float:
    """Return the time step, s: that of the model, or one for a model that takes any."""
    own = float(model.time_step)
    if options.time_step is not None and own and abs(options.time_step / own - 1) > 1e-6:
        raise UserError(
            f"--time-step is {options.time_step:g} s, and {options.model} steps by {own:g} s "
            "alone; leave the option out, or choose another model."
        )
    return own or options.time_step or _TIME_STEP


def _steps(start: Start, options: SimulateOptions) -> int:
    """Return the number of steps."""
    step = start.state.scene.time_step
    steps = round(options.seconds / step)
    if steps < 1:
        raise UserError(
            f"--seconds is {options.seconds:g}, less than the time step of {options.model}, "
            f"{step:g} s; simulate for longer."
        )
    if start.known_steps is not None and steps > start.known_steps:
        raise UserError(
            f"The solids of {options.choice.scene} move, and from this frame on their motion is "
            f"known for {start.known_steps * step:g} s; set --seconds to that or less."
        )
    return steps


def _summary(start: Start, steps: int, options: SimulateOptions, device: str) -> str:
    state, scene = start.state, start.state.scene
    motion = "none" if not len(state.solid_position) else "at rest"
    if start.solids is not None:
        motion = "moved as the scene says"
    lines = [
        f"Scene: {start.origin}",
        f"Fluid: {len(state):,} particles of radius {scene.particle_radius:g} m; "
        f"solids: {len(state.solid_position):,}, {motion}",
        f"Model: {options.model} on {device}, {steps} steps of {1000 * scene.time_step:g} ms",
    ]
    if not start.closed:
        lines.append("The scene has no walls around it: particles may go anywhere.")
    return "\n".join(lines)


def _tell(course: Course, rest: RestWatch | None) -> None:
    """Print how the simulation ended."""
    if course.interrupted:
        print(f"Interrupted: {course.frames} frames up to {course.time:.2f} s are kept.")
    elif course.rested and rest is not None:
        print(
            f"The fluid rests: 99.9 % of it was slower than {rest.bound:.2g} m/s for {DURATION:g} s"
            f" up to {course.time:.2f} s."
        )
    elif rest is not None and course.not_finite is None:
        print(f"The fluid does not rest after {course.time:.2f} s.")
    if course.burst:
        print(
            f"WARNING: particles reached {course.fastest:.3g} m/s, and a fall through the scene "
            f"{course.bound:.3g} m/s: the fluid burst apart. Choose a model for such scenes.",
            file=sys.stderr,
        )
