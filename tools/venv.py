"""`.venv`: made where it is missing, and entered; the torch that is there already is kept."""

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

# How the Python that starts this tells the one in `.venv` where the user's torch is.
TORCH_FOLDER_VARIABLE = "FLUIDSNET_TORCH_FOLDER"


def torch_folder() -> Path | None:
    """The folder that holds the torch this Python would import, found without importing it."""
    spec = importlib.util.find_spec("torch")
    return Path(spec.origin).parent.parent if spec and spec.origin else None


def torch_version() -> str | None:
    """As `torch.__version__`, which, unlike the package's, always says what it was built for."""
    folder = torch_folder()
    if folder is None:
        return None
    found = re.search(r"__version__ = '([^']+)'", (folder / "torch/version.py").read_text())
    return found.group(1) if found else importlib.metadata.version("torch")


def require_python() -> None:
    """Refuses a Python that is too old."""
    if sys.version_info < OLDEST_PYTHON:
        raise InstallError(
            f"FluidsNet needs Python {OLDEST_PYTHON[0]}.{OLDEST_PYTHON[1]} or newer and this is "
            f"{sys.version.split()[0]}: run `make clean`, then name a newer one, "
            "as in `make setup PYTHON=python3.12`."
        )


def make_venv(*options: str) -> None:
    """Makes `.venv`, or gives an existing one other options."""
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
    """Makes `.venv` where it is missing, and goes on with the Python in it."""
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
        # A virtual environment made from another one sees the system's packages, not the other
        # one's; for those, the Python in `.venv` is told the folder.
        shared = "include-system-site-packages = true" in (VENV / "pyvenv.cfg").read_text()
        if sys.prefix == sys.base_prefix and not shared:
            make_venv("--system-site-packages")
        environment[TORCH_FOLDER_VARIABLE] = str(folder)
    os.chdir(ROOT)
    os.execve(python, [str(python), "-m", "tools.install"], environment)
