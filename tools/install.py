"""Install FluidsNet and its dependencies into `.venv`; run by `make setup`.

Uses only the standard library. Any Python can start it: it creates `.venv` and runs itself again
with the Python in there. It ends at once if nothing has changed since the last installation.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import shlex
import signal
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any, NoReturn

from tools.compiled import COMPILED, compiled_wheels
from tools.jobs import ROOT, VENV, InstallError, pip_install, say
from tools.venv import (
    TORCH_FOLDER_VARIABLE,
    enter_venv,
    require_python,
    torch_folder,
    torch_version,
)

STAMP = VENV / ".fluidsnet-installed"

# The release that the tests run with.
DEFAULT_TORCH = "torch==2.13.0"
# By name, because Windows has no SIGHUP.
STOPPING = [s for s in signal.Signals if s.name in ("SIGINT", "SIGTERM", "SIGHUP")]


def fingerprint() -> str:
    """Return a hash that changes if the installation has to be checked again."""
    parts = [ROOT / "pyproject.toml", *sorted(Path(__file__).resolve().parent.glob("*.py"))]
    facts = f"{ROOT} {sys.version} {torch_version()}"
    return hashlib.sha256(b"".join(p.read_bytes() for p in parts) + facts.encode()).hexdigest()


def is_up_to_date() -> bool:
    """Return True if the last installation succeeded and nothing has changed since."""
    try:
        stamp = json.loads(STAMP.read_text())
    except (OSError, ValueError):
        return False
    wanted = os.environ.get("TORCH") or stamp["torch"]
    return bool(stamp["fingerprint"] == fingerprint() and stamp["torch"] == wanted)


def install_torch(oldest: str) -> None:
    """Install torch unless one is installed already.

    Args:
        oldest: Oldest version that FluidsNet works with.
    """
    requested = os.environ.get("TORCH")
    users = os.environ.get(TORCH_FOLDER_VARIABLE)
    if requested:
        pip_install(f"installing {requested}", *shlex.split(requested))
    elif users:
        if torch_folder() is None:
            link = Path(sysconfig.get_path("purelib")) / "fluidsnet_torch.pth"
            link.write_text(f"{users}\n")
            sys.path.append(users)
        say(f"using the installed torch {torch_version()} in {torch_folder()}")
    elif torch_folder() is None:
        pip_install(f"installing {DEFAULT_TORCH}", DEFAULT_TORCH)
    importlib.invalidate_caches()
    version = torch_version() or "0.0"
    if [int(n) for n in version.split(".")[:2]] < [int(n) for n in oldest.split(".")[:2]]:
        raise InstallError(
            f"torch {version} is too old, FluidsNet needs {oldest}: install another into .venv "
            f'with `make setup TORCH="{DEFAULT_TORCH}"`.'
        )


def lower_bound(requirement: str) -> str:
    """Return the lower bound of a requirement: `2.1.2` of `torch-scatter>=2.1.2,<3`."""
    return requirement.split(">=")[1].split(",")[0]


def install_solver(requirement: str, constraints: list[str]) -> None:
    """Install the solver if it has a wheel for this platform; print what it lacks to run."""
    only_wheel = ["--only-binary", "pysplishsplash"]
    try:
        pip_install("installing the solver", *only_wheel, *constraints, requirement)
    except InstallError:
        say(
            "The solver (pysplishsplash) could not be installed, most likely because it has no "
            "wheel for this platform: training and the demo work, generating data does not."
        )
        return
    if sys.platform.startswith("linux"):
        try:
            ctypes.CDLL("libGL.so.1")
        except OSError:
            say(
                "libGL.so.1 was not found: training and the demo work without it, generating "
                "data needs it (Debian: `apt-get install libgl1`)."
            )


def install() -> None:
    """Install everything into `.venv`; steps that are done already take seconds."""
    # Python 3.10 lacks it and has to reach the error message of `require_python`.
    import tomllib

    STAMP.unlink(missing_ok=True)
    if importlib.util.find_spec("pip") is None:
        make_pip = subprocess.run([sys.executable, "-m", "ensurepip"], capture_output=True)
        if make_pip.returncode != 0:
            raise InstallError(
                ".venv has no pip: install Python's venv module (Debian: `apt-get install "
                "python3-venv`), run `make clean`, and try again."
            )

    settings: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = settings["project"]["optional-dependencies"]
    requirements: list[str] = settings["project"]["dependencies"]
    compiled = {r.split(">=")[0]: r for r in requirements if r.split(">=")[0] in COMPILED}

    install_torch(next(lower_bound(r) for r in requirements if r.startswith("torch>")))
    pins = VENV / "fluidsnet-constraints.txt"
    pins.write_text(f"torch=={importlib.metadata.version('torch')}\n")
    constraints = ["-c", str(pins)]

    others = [r for r in requirements if r not in compiled.values()]
    build_tools = [*settings["build-system"]["requires"], "wheel", "ninja"]
    pip_install("installing packages", *constraints, *build_tools, *others, *extras["dev"])

    wheels = compiled_wheels({name: lower_bound(r) for name, r in compiled.items()})
    # By path and by force: other wheels of this version, and installed ones, may be for another
    # torch.
    options = ["--no-index", "--no-deps", "--force-reinstall"]
    pip_install("installing torch-scatter and torch-cluster", *options, *map(str, wheels))
    program = "import torch, torch_scatter, torch_cluster"
    if subprocess.run([sys.executable, "-c", program]).returncode != 0:
        raise InstallError(
            "torch-scatter or torch-cluster does not fit torch, as shown above: remove "
            f"{wheels[0].parent} and run this again."
        )

    pip_install("installing FluidsNet", "--no-deps", "--no-build-isolation", "-e", ".")
    install_solver(extras["solver"][0], constraints)

    stamp = {"fingerprint": fingerprint(), "torch": os.environ.get("TORCH", "")}
    whole = STAMP.with_suffix(".new")
    whole.write_text(json.dumps(stamp))
    whole.replace(STAMP)
    say("FluidsNet is installed: .venv/bin/fluidsnet")


def stop(*_: object) -> NoReturn:
    """Raise `KeyboardInterrupt` on a signal, so that running jobs are ended."""
    for number in STOPPING:  # make sends a second one, which must not interrupt the cleanup
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def main() -> int:
    """Install, or print one sentence that says why it failed."""
    if sys.platform == "win32":
        print("error: FluidsNet installs on Linux and macOS; use WSL on Windows.", file=sys.stderr)
        return 1
    for number in STOPPING:
        signal.signal(number, stop)
    try:
        if Path(sys.prefix).resolve() != VENV.resolve():
            enter_venv()
        require_python()
        if not is_up_to_date():
            install()
    except InstallError as error:
        if error.details:
            print(error.details, file=sys.stderr)
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"error: the installation stopped: {error}.", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nstopped; run it again to continue.", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
