"""Create `.venv` and continue in its Python; keep a torch that is already installed."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NoReturn

from tools.jobs import ROOT, VENV, InstallError, say

OLDEST_PYTHON = (3, 11)

# Environment variable that tells the Python in `.venv` the folder of the user's torch.
TORCH_FOLDER_VARIABLE = "FLUIDSNET_TORCH_FOLDER"


def torch_folder() -> Path | None:
    """Return the folder that this Python would import torch from, without importing it."""
    spec = importlib.util.find_spec("torch")
    return Path(spec.origin).parent.parent if spec and spec.origin else None


def torch_version() -> str | None:
    """Return `torch.__version__`, which names the build; the package's version may not."""
    folder = torch_folder()
    if folder is None:
        return None
    found = re.search(r"__version__ = '([^']+)'", (folder / "torch/version.py").read_text())
    return found.group(1) if found else importlib.metadata.version("torch")


def require_python() -> None:
    """Raise `InstallError` if this Python is too old."""
    if sys.version_info < OLDEST_PYTHON:
        raise InstallError(
            f"FluidsNet needs Python {OLDEST_PYTHON[0]}.{OLDEST_PYTHON[1]} or newer and this is "
            f"{sys.version.split()[0]}: run `make clean`, then name a newer one, "
            "as in `make setup PYTHON=python3.12`."
        )


def make_venv(*options: str) -> None:
    """Create `.venv`, or change the options of an existing one."""
    require_python()
    done = subprocess.run(
        [sys.executable, "-m", "venv", *options, str(VENV)], capture_output=True, text=True
    )
    if done.returncode != 0:
        raise InstallError(
            f"{sys.executable} cannot make a virtual environment: install its venv module "
            "(Debian: `apt-get install python3-venv`).",
            (done.stdout + done.stderr).strip(),
        )


def enter_venv() -> NoReturn:
    """Create `.venv` if it is missing, and replace this process by its Python."""
    python = VENV / "bin/python"
    if not python.exists():
        say("making .venv")
        make_venv("--clear")
    environment = {**os.environ}
    environment.pop(TORCH_FOLDER_VARIABLE, None)
    packages = VENV / "lib/python{}.{}/site-packages".format(*sys.version_info)
    folder = torch_folder()
    if (
        folder is not None
        and not os.environ.get("TORCH")
        and packages.is_dir()
        and not (packages / "torch").exists()
    ):
        # With --system-site-packages, `.venv` sees the system's torch, but not one that is in
        # another virtual environment; its folder is passed on.
        shared = "include-system-site-packages = true" in (VENV / "pyvenv.cfg").read_text()
        if sys.prefix == sys.base_prefix and not shared:
            make_venv("--system-site-packages")
        environment[TORCH_FOLDER_VARIABLE] = str(folder)
    os.chdir(ROOT)
    os.execve(python, [str(python), "-m", "tools.install"], environment)
