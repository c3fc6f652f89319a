"""``make demo``: generate data, train, test, roll out, and list the files."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
RUN = Path("runs") / "demo"
#: IISPH, which makes the data, solves for density alone.
OF_IISPH = (
    "--model.init_args.prior.init_args.divergence_sweeps=0",
    "--model.init_args.prior.init_args.sweeps=4",
    "--model.init_args.prior.init_args.substeps=2",
)


def fluidsnet(*arguments: str) -> None:
    """Print and run a `fluidsnet` command; exit if it fails."""
    print(f"\n$ fluidsnet {' '.join(arguments)}", flush=True)
    program = [sys.executable, "-m", "fluidsnet.main", *arguments]
    status = subprocess.run(program, cwd=ROOT, check=False).returncode
    if status != 0:
        sys.exit(f"The demo stops here: the command above failed with status {status}.")


def reason_against_the_solver() -> str | None:
    """Return the reason why the solver cannot run on this machine, None if it can."""
    # In a subprocess: loading the solver may crash Python.
    probe = "from datamodules.generate.solver import load_solver as load; load()"
    done = subprocess.run(
        [sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines()
    return lines[-1].partition(": ")[2] if lines else f"it ends with status {done.returncode}"


def main() -> None:
    """Run the demo in the repository's root."""
    started = time.monotonic()
    reason = reason_against_the_solver()
    if reason is None:
        fluidsnet("generate", "--config", "configs/scene/demo.yaml", "--root", "data/demo")
        data = "demo"
    else:
        print(f"The solver cannot run here: {reason}")
        print("The demo goes on with the small sample that ships with the tests.")
        data = "sample"
    generated = time.monotonic()
    shutil.rmtree(ROOT / RUN, ignore_errors=True)
    configs = ("trainer", "model/corrected", f"data/{data}", "demo")
    fluidsnet("fit", *(f"--config=configs/{config}.yaml" for config in configs), *OF_IISPH)
    trained = time.monotonic()
    fluidsnet("test", "--run", str(RUN))
    fluidsnet("predict", "--run", str(RUN))
    ended = time.monotonic()
    # The folder has the name of the data's folder.
    results = RUN / "results" / ("demo" if data == "demo" else "dam_break")
    print(
        f"""
The demo took {ended - started:.0f} s: data {generated - started:.0f} s, training \
{trained - generated:.0f} s, test and rollouts {ended - trained:.0f} s.

  errors of one step, and baselines    {results}/one_step.md
  metrics of the rollouts              {results}/rollout_metrics.md and .png
  metrics of the predicted rollouts    {results}/rollout_metrics_predict.md
  truth and prediction side by side    {results}/rollout.png
  rollouts for ParaView                {results}/rollouts/*.vtkhdf
  checkpoint                           {RUN}/checkpoints/best.ckpt
  configuration                        {RUN}/config.yaml
  TensorBoard events                   {RUN}/events.out.tfevents.*

To see the curves of the training, run
  .venv/bin/tensorboard --logdir runs"""
    )


if __name__ == "__main__":
    main()
