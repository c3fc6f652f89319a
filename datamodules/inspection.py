"""``fluidsnet inspect``: summary of a data file and checks for suspicious values."""

from __future__ import annotations

from argparse import ArgumentParser
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from datamodules.schema import DAMAGE, Header, open_valid, simulations
from fluidsnet.errors import UserError
from fluidsnet.progress import Progress


@dataclass
class SimulationReport:
    """Summary of one simulation.

    Attributes:
        name: Name of the group.
        frames: Number of frames.
        fluid, solid: Number of particles.
        lower, upper: Corners of the fluid's bounding box over all frames, m.
        fastest: Greatest speed, m/s.
        solver_seconds: Wall time of the solver for all steps, s.
        threads: Threads of the solver, or a question mark where the file does not say.
        suspicions: Descriptions of suspicious values.
    """

    name: str
    frames: int
    fluid: int
    solid: int
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    fastest: float
    solver_seconds: float
    threads: str
    suspicions: list[str]


def inspect_simulation(group: h5py.Group, header: Header) -> SimulationReport:
    """Summarize a simulation, reading it frame by frame.

    Args:
        group: Group of the simulation.
        header: Attributes of the file.
    """
    name = group.name.lstrip("/")
    frames, fluid = group["position"].shape[:2]
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    domain_lower, domain_upper = np.array(header.domain_lower), np.array(header.domain_upper)
    fastest, escaped, worst_jump = 0.0, 0, 0.0
    suspicions: list[str] = []
    not_finite: list[int] = []
    before: NDArray[np.float64] | None = None
    for frame in Progress(range(frames), desc=f"reading /{name}", unit="frame", leave=False):
        position = group["position"][frame].astype(np.float64)
        velocity = group["velocity"][frame].astype(np.float64)
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            not_finite.append(frame)
            before = None
            continue
        lower, upper = np.minimum(lower, position.min(0)), np.maximum(upper, position.max(0))
        fastest = max(fastest, float(np.linalg.norm(velocity, axis=1).max()))
        radius = header.particle_radius
        outside = (position < domain_lower - radius) | (position > domain_upper + radius)
        escaped = max(escaped, int(outside.any(axis=1).sum()))
        if before is not None:
            # A row moves with its velocity, unless it changes to another particle.
            moved = np.linalg.norm(position - before - header.dt * velocity, axis=1)
            worst_jump = max(worst_jump, float(np.quantile(moved, 0.99)))
        before = position
    if not_finite:
        suspicions.append(f"{len(not_finite)} frames are not finite, the first is {not_finite[0]}")
    if escaped:
        suspicions.append(f"up to {escaped} particles are outside the domain at once")
    if worst_jump > 2 * header.particle_radius:
        suspicions.append(
            f"positions and velocities disagree by {worst_jump:.3g} m per frame for 1 % of the "
            "particles: rows may not keep their particle, or dt may be wrong"
        )
    times = group["time"][()]
    if frames > 1 and not np.allclose(np.diff(times), header.dt, rtol=1e-3, atol=0):
        suspicions.append("the frames are not dt apart")
    if fastest == 0:
        suspicions.append("nothing moves")
    return SimulationReport(
        name=name,
        frames=frames,
        fluid=fluid,
        solid=group["solid_position"].shape[-2],
        lower=lower,
        upper=upper,
        fastest=fastest,
        solver_seconds=float(group["solver_seconds"][()].sum()),
        threads=str(group.attrs.get("threads", "?")),
        suspicions=suspicions,
    )


def describe(path: Path) -> str:
    """Return a summary of a file as text.

    Args:
        path: Path of a data file.

    Raises:
        UserError: the file is not valid, or damaged.
    """
    with open_valid(path) as file:
        header = Header.read(file)
        try:
            reports = [inspect_simulation(file[name], header) for name in simulations(file)]
        except DAMAGE as error:
            raise UserError(
                f"{path}: a frame cannot be read; the file is damaged ({error})."
            ) from error
    size = " x ".join(
        f"{high - low:g}"
        for low, high in zip(header.domain_lower, header.domain_upper, strict=True)
    )
    lines = [
        f"{path}: {path.stat().st_size / 1e6:.1f} MB, {len(reports)} simulation(s)",
        f"  scene            {header.scene} in {size} m",
        f"  solver           {header.solver}, version {header.solver_version}",
        f"  particle radius  {header.particle_radius:g} m, support {header.support_radius:g} m",
        f"  frame interval   {1000 * header.dt:g} ms",
        f"  gravity          {', '.join(f'{g:g}' for g in header.gravity)} m/s²",
        f"  density          {header.density0:g} kg/m³, viscosity {header.viscosity:g}",
        "",
        "  simulation  frames   time s    fluid    solid  fastest m/s  solver s per s (threads)",
    ]
    for report in reports:
        time = (report.frames - 1) * header.dt
        cost = report.solver_seconds / time if time else 0.0
        lines.append(
            f"  {report.name:>10}  {report.frames:6}  {time:7.3f}  {report.fluid:7}  "
            f"{report.solid:7}  {report.fastest:11.2f}  {cost:14.1f} ({report.threads})"
        )
    lower = np.min([report.lower for report in reports], axis=0)
    upper = np.max([report.upper for report in reports], axis=0)
    lines += [
        "",
        f"  fluid lies between ({', '.join(f'{x:.3f}' for x in lower)}) "
        f"and ({', '.join(f'{x:.3f}' for x in upper)}) m",
    ]
    suspicions = [f"  /{report.name}: {text}" for report in reports for text in report.suspicions]
    lines += ["", "suspicious:", *suspicions] if suspicions else ["  nothing suspicious"]
    return "\n".join(lines)


def inspect_command(arguments: list[str]) -> None:
    """Print a summary of each file named in the arguments.

    Raises:
        UserError: a file is not valid.
    """
    parser = ArgumentParser(
        prog="fluidsnet inspect",
        description="Print a summary of data files, and warn of suspicious values in them.",
    )
    parser.add_argument(
        "files", nargs="+", type=Path, metavar="FILE", help="data file, such as train.h5"
    )
    for path in parser.parse_args(arguments).files:
        print(describe(path))
