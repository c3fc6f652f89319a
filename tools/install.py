"""Install FluidsNet and its dependencies into `.venv`; run by `make setup`.

Uses only the standard library. Creates `.venv`, continues in its Python, and ends at once if
nothing has changed since the last installation.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / ".venv"
STAMP = VENV / ".fluidsnet-installed"
PIP = [sys.executable, "-m", "pip", "-q"]
OLDEST_PYTHON = (3, 11)
# The release that the tests run with.
DEFAULT_TORCH = "torch==2.13.0"
# They come as source only, and fit only the torch that they were compiled against.
COMPILED = ("torch-scatter", "torch-cluster")


class InstallError(Exception):
    """Failed installation, with one sentence for the user."""


def run(
    commands: dict[str, list[str]], logs: Path = VENV, environment: dict[str, str] | None = None
) -> None:
    """Run commands in parallel, and print a line every 30 s.

    Args:
        commands: Commands by title.
        logs: Folder of the log files; outside `.venv`, compiled files in it are counted.
        environment: Environment variables to set.

    Raises:
        InstallError: A command failed; the others are ended.
    """
    title = ", ".join(commands)
    print(f"{title} …", flush=True)
    started, lines = time.monotonic(), 1
    running: dict[Path, subprocess.Popen[bytes]] = {}
    try:
        for name, command in commands.items():
            log = logs / f"{name.replace(' ', '-')}.log"
            with log.open("wb") as output:
                running[log] = subprocess.Popen(
                    command,
                    cwd=ROOT,
                    env={**os.environ, **(environment or {})},
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,  # so that its compilers end with it
                )
        while running:
            time.sleep(0.1)
            seconds = time.monotonic() - started
            for log in [log for log, process in running.items() if process.poll() is not None]:
                if running.pop(log).returncode != 0:
                    print(*log.read_text(errors="replace").splitlines()[-15:], sep="\n")
                    raise InstallError(f"{log.stem} failed, as above; its log is {log}")
            if seconds > 30 * lines:
                lines += 1
                files = "" if logs == VENV else f", {len([*logs.rglob('*.o')])} files compiled"
                print(f"{title}: {seconds:.0f} s{files}", flush=True)
    finally:
        for process in running.values():
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()


def lower_bound(package: str) -> str:
    """Return the lower bound of a dependency in pyproject.toml."""
    bound = re.search(rf'"{package}>=([\d.]+)', (ROOT / "pyproject.toml").read_text())
    assert bound is not None
    return bound.group(1)


def torch_folder() -> Path | None:
    """Return the folder that this Python would import torch from, without importing it."""
    importlib.invalidate_caches()
    spec = importlib.util.find_spec("torch")
    return Path(spec.origin).parents[1] if spec and spec.origin else None


def torch_version() -> str:
    """Return `torch.__version__`, which names the build; empty if torch is not installed."""
    folder = torch_folder()
    text = (folder / "torch/version.py").read_text() if folder else ""
    found = re.search(r"__version__ = '([^']+)'", text)
    return found.group(1) if found else ""


def fingerprint() -> str:
    """Return a hash that changes if the installation has to be repeated."""
    files = (ROOT / "pyproject.toml").read_bytes() + Path(__file__).read_bytes()
    return hashlib.sha256(files + f"{ROOT} {sys.version} {torch_version()}".encode()).hexdigest()


def enter_venv() -> None:
    """Create `.venv`, with a link to the torch of this Python, and continue in its Python."""
    python = VENV / "bin/python"
    if sys.version_info < OLDEST_PYTHON:
        raise InstallError(
            f"FluidsNet needs Python 3.11 or newer and this is {sys.version.split()[0]}: name a "
            "newer one, as in `make setup PYTHON=python3.12`"
        )
    if not (VENV / "bin/pip").exists():
        print("making .venv", flush=True)
        if subprocess.run([sys.executable, "-m", "venv", "--clear", str(VENV)]).returncode != 0:
            raise InstallError(
                "no virtual environment could be made, as above: install Python's venv module "
                "(Debian: `apt-get install python3-venv`)"
            )
        folder = torch_folder()
        if folder is not None and not os.environ.get("TORCH"):
            print(f"using the torch {torch_version()} in {folder}", flush=True)
            packages = VENV / "lib/python{}.{}/site-packages".format(*sys.version_info)
            (packages / "fluidsnet_torch.pth").write_text(f"{folder}\n")
    os.chdir(ROOT)
    os.execv(python, [str(python), "-m", "tools.install"])


def compiled_wheels() -> list[Path]:
    """Return the wheels of torch-scatter and torch-cluster for this torch; compile missing ones."""
    # The same question as their setup.py asks.
    program = (
        "import torch; from torch.utils.cpp_extension import CUDA_HOME; "
        "print(torch.cuda.is_available(), bool(CUDA_HOME or torch.version.hip))"
    )
    asked = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    if asked.returncode != 0:
        raise InstallError("importing torch fails, as above: run `make clean` and try again")
    gpu, compiler = (word == "True" for word in asked.stdout.split()[-2:])
    if gpu and not compiler:
        print(
            "There is a GPU but no CUDA compiler (nvcc): torch-scatter and torch-cluster will run "
            "on the CPU only. To change that, install the CUDA toolkit and run this again."
        )
    python = "cp{}{}".format(*sys.version_info) + ("t" if "t" in sys.abiflags else "")
    platform = re.sub(r"\W", "_", sysconfig.get_platform())
    tag = f"{python}-torch{torch_version()}-{platform}{'-cuda' if gpu and compiler else ''}"
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "fluidsnet/wheels" / tag
    folder.mkdir(parents=True, exist_ok=True)
    wheels = {name: f"{name.replace('-', '_')}-{lower_bound(name)}-*.whl" for name in COMPILED}
    missing = [name for name, pattern in wheels.items() if not [*folder.glob(pattern)]]
    if missing:
        compile_wheels(missing, folder, parallel=not (gpu and compiler))
    return [next(folder.glob(pattern)) for pattern in wheels.values()]


def compile_wheels(names: list[str], folder: Path, parallel: bool) -> None:
    """Compile packages side by side; a wheel appears in the folder only when it is complete."""
    needs = "a C++ compiler and Python's headers (Debian: `apt-get install g++ python3-dev`)"
    compilers = (os.environ.get("CXX"), "c++", "g++", "clang++")
    compiler = next((c for c in compilers if c and shutil.which(shlex.split(c)[0])), None)
    if compiler is None or not Path(sysconfig.get_path("include"), "Python.h").exists():
        raise InstallError(f"torch-scatter and torch-cluster are compiled here: install {needs}")
    print(
        "compiling 23 files (more with CUDA), once for this torch: about four minutes on two cores;"
    )
    print(f"the wheels are kept in {folder}")
    # Each compiler needs up to 2 GiB.
    gibibytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") >> 30
    cores = min(len(os.sched_getaffinity(0)), gibibytes // 2)
    jobs = int(os.environ.get("MAX_JOBS", max(1, cores)))
    # Python may have been built with another compiler than this machine has.
    linker = (sysconfig.get_config_var("LDCXXSHARED") or "c++ -shared").partition(" ")[2]
    with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as name:
        scratch = Path(name)
        environment = {
            "TMPDIR": name,
            "CXX": compiler,
            "LDCXXSHARED": os.environ.get("LDCXXSHARED", f"{compiler} {linker}"),
            # Debug information would be a third of the compiler's work.
            "CPPFLAGS": f"{os.environ.get('CPPFLAGS', '')} -g0",
        }
        # Not for CUDA: torch changes the compiler object that setuptools shares between threads.
        if parallel:
            (scratch / "build.cfg").write_text("[build_ext]\nparallel = 16\n")
            environment["DIST_EXTRA_CONFIG"] = str(scratch / "build.cfg")
            front = [sys.executable, str(ROOT / "tools/compiler.py"), name, str(jobs)]
            environment["CXX"] = f"{shlex.join(front)} {compiler}"
        # pip's cache does not know which torch a wheel was compiled against.
        wheel = [*PIP, "wheel", "--no-build-isolation", "--no-deps", "--no-cache-dir", "-w", name]
        commands = {f"building {p}": [*wheel, f"{p}=={lower_bound(p)}"] for p in names}
        try:
            run(commands, folder, environment)
        except InstallError as error:
            raise InstallError(f"{error}. It needs {needs} and 2 GB of memory a core") from None
        for built in scratch.glob("*.whl"):
            built.replace(folder / built.name)


def install(torch: str) -> None:
    """Install everything; `torch` is pip's requirement, or empty to keep the installed torch."""
    STAMP.unlink(missing_ok=True)
    wanted = shlex.split(torch) or ([] if torch_version() else [DEFAULT_TORCH])
    wanted.append(f"torch>={lower_bound('torch')}")
    run({"installing torch": [*PIP, "install", *wanted]})
    run({"installing build tools": [*PIP, "install", "setuptools>=77", "wheel", "numpy"]})
    wheels = compiled_wheels()
    # By force: installed ones of the same version may be for another torch.
    options = ["--no-index", "--no-deps", "--force-reinstall"]
    run({f"installing {' and '.join(COMPILED)}": [*PIP, "install", *options, *map(str, wheels)]})
    editable = [*PIP, "install", "--no-build-isolation", "--only-binary", "pysplishsplash", "-e"]
    try:
        run({"installing FluidsNet with the solver": [*editable, ".[dev,scatter,solver]"]})
    except InstallError as error:
        print(f"{error}. Most likely the solver has no wheel here; only `generate` needs it.")
        run({"installing FluidsNet": [*editable, ".[dev,scatter]"]})
    if subprocess.run([sys.executable, "-c", "import torch_scatter, torch_cluster"]).returncode:
        raise InstallError(
            "torch-scatter or torch-cluster does not fit torch, as above: remove "
            f"{wheels[0].parent} and try again"
        )


def main() -> None:
    """Install, or exit with one sentence that says why it failed."""
    for number in (signal.SIGTERM, signal.SIGHUP):  # raise, so that the compilers are ended
        signal.signal(number, signal.default_int_handler)
    try:
        if Path(sys.prefix).resolve() != VENV.resolve():
            enter_venv()
        torch = os.environ.get("TORCH", "")
        stamp = STAMP.read_text().split("\n") if STAMP.exists() else []
        if stamp and stamp == [fingerprint(), torch or stamp[-1]]:
            return
        install(torch)
        STAMP.write_text(f"{fingerprint()}\n{torch}")
        print("FluidsNet is installed: .venv/bin/fluidsnet")
    except (InstallError, OSError) as error:
        sys.exit(f"error: {error}.")
    except KeyboardInterrupt:
        sys.exit("\nstopped; run it again to continue.")


if __name__ == "__main__":
    main()
