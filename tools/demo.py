"""``make demo``: data, training, test, rollout, and where each of them lies."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
RUN = Path("runs") / "demo"


def fluidsnet(*words: str) -> None:
    """Runs a command of the program, shown first as one would type it."""
    print(f"\n$ fluidsnet {' '.join(words)}", flush=True)
    ended = subprocess.run([sys.executable, "-m", "fluidsnet.main", *words], cwd=ROOT, check=False)
    if ended.returncode != 0:
        sys.exit(f"The demo stops here: the command above failed ({ended.returncode}).")


def reason_against_the_solver() -> str | None:
    """Why the solver cannot run here, or None where it can."""
    # In a process of its own: where the solver cannot be loaded it may take Python with it.
    probe = "from datamodules.generate.solver import load_solver as load; load()"
    tried = subprocess.run(
        [sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if tried.returncode == 0:
        return None
    words = tried.stderr.strip().splitlines()
    return words[-1].partition(": ")[2] if words else f"it ends with status {tried.returncode}"


def main() -> None:
    """Runs the demo from the repository's root."""
    started = time.monotonic()
    configs = ["configs/trainer.yaml", "configs/model/field.yaml"]
    reason = reason_against_the_solver()
    if reason is None:
        fluidsnet("generate", "--config", "configs/scene/demo.yaml", "--root", "data/demo")
        configs.append("configs/data/demo.yaml")
    else:
        print(f"The solver cannot run here: {reason}")
        print("The demo goes on with the small sample that ships with the tests.")
        configs.append("configs/data/sample.yaml")
    made = time.monotonic()
    shutil.rmtree(ROOT / RUN, ignore_errors=True)
    composed = [word for config in [*configs, "configs/demo.yaml"] for word in ("--config", config)]
    fluidsnet("fit", *composed)
    trained = time.monotonic()
    fluidsnet("test", "--run", str(RUN))
    fluidsnet("predict", "--run", str(RUN))
    ended = time.monotonic()
    print(
        f"""
The demo took {ended - started:.0f} s: data {made - started:.0f} s, training \
{trained - made:.0f} s, test and rollouts {ended - trained:.0f} s.

  one step beside trivial predictors  {RUN}/one_step.md
  every metric of the rollouts        {RUN}/rollout_metrics.md and .png
  errors of the rollouts              {RUN}/rollout.md
  truth and prediction side by side   {RUN}/rollout.png
  rollouts for ParaView               {RUN}/rollouts/*.vtkhdf
  checkpoint                          {RUN}/checkpoints/best.ckpt
  configuration                       {RUN}/config.yaml
  TensorBoard events                  {RUN}/events.out.tfevents.*

Look at the training with
  .venv/bin/tensorboard --logdir runs"""
    )


if __name__ == "__main__":
    main()
