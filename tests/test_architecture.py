"""Imports run downward only."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]

#: What may import what: a module may import those of a lower rank, and its own package.
RANKS = {
    "fluidsnet.batch": 0,
    "fluidsnet.cache": 0,
    "fluidsnet.checkpoint_io": 12,
    "fluidsnet.checksums": 2,
    "fluidsnet.child_process": 0,
    "fluidsnet.compile_cache": 0,
    "fluidsnet.console": 0,
    "fluidsnet.deprecated": 0,
    "fluidsnet.disk_space": 1,
    "fluidsnet.distributed": 0,
    "fluidsnet.errors": 0,
    "fluidsnet.folder_lock": 1,
    "fluidsnet.memory": 0,
    "fluidsnet.plain_yaml": 1,
    "fluidsnet.printable": 0,
    "fluidsnet.progress": 0,
    "fluidsnet.resume": 1,
    "fluidsnet.rng": 0,
    "fluidsnet.same_settings": 0,
    "fluidsnet.statistics": 0,
    "fluidsnet.whole_file": 1,
    "fluidsnet.export": 4,
    "fluidsnet.loss": 1,
    "fluidsnet.scene": 1,
    "fluidsnet.torch_extensions": 1,
    "fluidsnet.particles": 2,
    "fluidsnet.periodic": 3,
    "fluidsnet.schedule": 1,
    "fluidsnet.kernels": 3,
    "fluidsnet.neighbors": 4,
    "fluidsnet.moments": 5,
    "fluidsnet.noise": 3,
    "fluidsnet.target": 7,
    "fluidsnet.walls": 3,
    "fluidsnet.sph": 5,
    "fluidsnet.priors": 6,
    "fluidsnet.calibration": 7,
    "fluidsnet.features": 7,
    "fluidsnet.integrator": 8,
    "fluidsnet.baselines": 9,
    "fluidsnet.network": 8,
    "fluidsnet.scene_checks": 9,
    "fluidsnet.metrics": 10,
    "fluidsnet.model": 10,
    "fluidsnet.batched": 11,
    "fluidsnet.block_types": 11,
    "fluidsnet.checkpoint": 11,
    "fluidsnet.checkpoint_migration": 12,
    "fluidsnet.compiled": 11,
    "fluidsnet.logger": 12,
    "fluidsnet.one_step": 12,
    "fluidsnet.optimization": 12,
    "fluidsnet.rollout": 11,
    "fluidsnet.training_cost": 12,
    "fluidsnet.module": 13,
    "fluidsnet.models": 14,
    "fluidsnet": 15,
    "fluidsnet.reporting": 14,
    "fluidsnet.stress": 15,
    "callbacks": 16,
    "datamodules": 16,
    "fluidsnet.arguments": 16,
    "fluidsnet.cli": 17,
    "fluidsnet.doctor": 18,
    "fluidsnet.report": 18,
    "fluidsnet.studies": 19,
    "fluidsnet.main": 20,
}

#: All that the data modules may know of the rest.
KNOWN_TO_DATA = {
    "fluidsnet.checksums",
    "fluidsnet.child_process",
    "fluidsnet.disk_space",
    "fluidsnet.distributed",
    "fluidsnet.errors",
    "fluidsnet.folder_lock",
    "fluidsnet.particles",
    "fluidsnet.periodic",
    "fluidsnet.printable",
    "fluidsnet.progress",
    "fluidsnet.rng",
    "fluidsnet.scene",
    "fluidsnet.statistics",
    "fluidsnet.whole_file",
}


def modules() -> dict[str, Path]:
    found = {}
    for package in ("fluidsnet", "datamodules", "callbacks"):
        for path in (ROOT / package).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def place(module: str) -> str:
    """The longest name in `RANKS` that a module lies under."""
    named = [name for name in RANKS if module == name or module.startswith(f"{name}.")]
    # The package's own __init__ re-exports; nothing else may hide behind its rank.
    assert named and (max(named, key=len) != "fluidsnet" or module == "fluidsnet"), (
        f"{module} has no rank: say where it belongs"
    )
    return max(named, key=len)


def imports(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: a relative import hides where it leads"
            names.add(node.module)
    return {
        name for name in names if name.split(".")[0] in ("fluidsnet", "datamodules", "callbacks")
    }


def test_imports_run_downward_only() -> None:
    wrong = []
    for module, path in modules().items():
        here = place(module)
        for imported in imports(path):
            there = place(imported)
            if here != there and RANKS[there] >= RANKS[here]:
                wrong.append(f"{module} imports {imported}")
            if here == "datamodules" and there not in {*KNOWN_TO_DATA, "datamodules"}:
                wrong.append(f"{module} imports {imported}")
    assert not wrong


def test_only_one_module_imports_the_solver() -> None:
    importers = [
        module for module, path in modules().items() if "import pysplishsplash" in path.read_text()
    ]
    assert importers == ["datamodules.generate.solver"]


def test_only_kernels_import_numba() -> None:
    importers = {
        place(module)
        for module, path in modules().items()
        for node in ast.walk(ast.parse(path.read_text()))
        if (isinstance(node, ast.Import) and any("numba" in alias.name for alias in node.names))
        or (isinstance(node, ast.ImportFrom) and "numba" in (node.module or ""))
    }
    assert importers == {"fluidsnet.kernels"}


def test_only_one_module_imports_torch_cluster_and_torch_scatter() -> None:
    importers = {
        module
        for module, path in modules().items()
        for node in ast.walk(ast.parse(path.read_text()))
        if (
            isinstance(node, ast.Import)
            and any(alias.name in ("torch_cluster", "torch_scatter") for alias in node.names)
        )
        or (isinstance(node, ast.ImportFrom) and node.module in ("torch_cluster", "torch_scatter"))
    }
    assert importers == {"fluidsnet.torch_extensions"}


def test_the_network_knows_neither_lightning_nor_hdf5() -> None:
    for module, path in modules().items():
        if (
            RANKS[place(module)] <= RANKS["fluidsnet.rollout"]
            and place(module) != "fluidsnet.export"
        ):
            tree = ast.parse(path.read_text())
            named = {
                alias.name.split(".")[0]
                for node in ast.walk(tree)
                if isinstance(node, ast.Import)
                for alias in node.names
            } | {
                str(node.module).split(".")[0]
                for node in ast.walk(tree)
                if isinstance(node, ast.ImportFrom)
            }
            assert not named & {"lightning", "h5py"}, module


def test_no_dumping_grounds() -> None:
    names = {path.stem for path in modules().values()}
    assert not names & {"utils", "util", "helpers", "common", "misc"}


def test_no_import_circles() -> None:
    known = modules()
    graph: dict[str, set[str]] = {}
    for module, path in known.items():
        names = imports(path)
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                # A module may be imported from its package.
                names |= {f"{node.module}.{alias.name}" for alias in node.names}
        graph[module] = names & known.keys()
    assert sum(map(len, graph.values())) > len(known)
    TopologicalSorter(graph).prepare()  # raises CycleError
