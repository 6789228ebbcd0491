"""The shape of the package: which room imports which, what an import costs, what may shadow it."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

# Each room may import itself and those before it.
ROOMS = ("guided_gym", "guided_gym.envs", "guided_gym.agents", "guided_gym.train")
HEAVY = ("torch", "ompl", "pygame", "matplotlib", "networkx", "stable_baselines3", "scipy.spatial", "pandas")
REPOSITORY = Path(__file__).resolve().parents[1]
LONGEST_FUNCTION = 60  # lines, without the docstring


def _folder(room: str) -> Path:
    spec = importlib.util.find_spec(room)
    assert spec is not None, f"{room} is not installed"
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0])


def _modules() -> Iterator[tuple[str, str, Path]]:
    """(room, dotted name, file) of each module of the installed package."""
    folders = {room: _folder(room) for room in ROOMS}
    others = set(folders.values()) - {folders["guided_gym"]}
    for room, folder in folders.items():
        for file in sorted(folder.rglob("*.py")):
            # In a wheel the other rooms lie inside the first one's folder; in a checkout beside it.
            if room == "guided_gym" and others & set(file.parents):
                continue
            parts = file.relative_to(folder).with_suffix("").parts
            parts = parts[:-1] if parts[-1] == "__init__" else parts
            yield room, ".".join((room, *parts)), file


MODULES = list(_modules())


def _imported(name: str, file: Path) -> Iterator[str]:
    """Dotted names that a module imports, anywhere in it; `from a import b` counts as a and as a.b."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = importlib.util.resolve_name("." * node.level + base, package)
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _room_of(name: str) -> str | None:
    rooms = [room for room in ROOMS if name == room or name.startswith(f"{room}.")]
    return max(rooms, key=len) if rooms else None


def test_the_package_was_found() -> None:
    assert {room for room, _, _ in MODULES} == set(ROOMS)


@pytest.mark.parametrize(("room", "name", "file"), MODULES, ids=[name for _, name, _ in MODULES])
def test_imports_run_one_way(room: str, name: str, file: Path) -> None:
    allowed = ROOMS[: ROOMS.index(room) + 1]
    for imported in _imported(name, file):
        target = _room_of(imported)
        assert target is None or target in allowed, f"{name} imports {imported}; may import {allowed} only"
        assert imported.split(".")[0] not in {"envs", "agents", "train"}, f"{name} imports a bare {imported}"


# The rooms of the core, in the order in which they build upon each other. A module that is no folder is a
# room of its own.
CORE = (
    "errors",
    "checks",
    "doors",
    "registration",
    "compute",
    "kernels",
    "structures",
    "geometry",
    "options",
    "randomness",
    "problems",
    "trajectories",
    "search",
    "storage",
    "measure",
    "guidance",
    "planners",
    "catalogue",
    "traces",
    "planning",
    "display",
)
# Who knows the truth. Guiding spaces do not: but for the exact solver, none could be measured honestly.
MAY_MEASURE = ("measure", "planning", "catalogue", "guidance.solvers.exact", "display.notebook")


def _core(name: str) -> str | None:
    """The room of a module of the core, without ``guided_gym.``; None for others and for the package."""
    if _room_of(name) != "guided_gym" or name == "guided_gym":
        return None
    part = name.split(".")[1]
    return part if part in CORE else None


def _core_imports() -> Iterator[tuple[str, str]]:
    for room, name, file in MODULES:
        if room == "guided_gym" and name != "guided_gym":
            yield from ((name, imported) for imported in _imported(name, file))


def test_the_core_is_a_row_of_rooms() -> None:
    """No circle, one way only: each module imports its own room and those before it, wherever it does so."""
    wrong = []
    for name, imported in _core_imports():
        here, there = _core(name), _core(imported)
        assert here is not None, f"{name} stands in no room: add it to CORE"
        if there is not None and CORE.index(there) > CORE.index(here):
            wrong.append(f"{name} imports {imported}")
    assert wrong == []


def test_no_module_of_the_core_imports_in_a_circle() -> None:
    modules = {name for room, name, _ in MODULES if room == "guided_gym"}
    arrows: dict[str, set[str]] = {name: set() for name in modules}
    for name, imported in _core_imports():
        if imported in modules and imported != name:
            arrows[name].add(imported)
    left = dict(arrows)
    while ready := [name for name, targets in left.items() if not targets & left.keys()]:
        for name in ready:
            del left[name]
    assert sorted(left) == []


def test_only_these_know_the_truth() -> None:
    wrong = []
    for name, imported in _core_imports():
        inside = name.removeprefix("guided_gym.")
        allowed = any(inside == room or inside.startswith(f"{room}.") for room in MAY_MEASURE)
        if _core(imported) == "measure" and not allowed:
            wrong.append(f"{name} imports {imported}")
    assert wrong == []


def test_docs_and_examples_import_public_names_only() -> None:
    import guided_gym

    pages = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
    pages += sorted((REPOSITORY / "examples").glob("*.py"))
    wrong = []
    for page in pages:
        for line in page.read_text(encoding="utf-8").splitlines():
            words = line.split()
            if words[:1] != ["from"] or len(words) < 4 or not words[1].startswith("guided_gym"):
                continue
            names = [name.strip(" ()") for name in line.partition(" import ")[2].split(",")]
            if words[1] != "guided_gym" or not {name for name in names if name} <= set(guided_gym.__all__):
                wrong.append(f"{page.name}: {line}")
    assert wrong == []


def test_public_names_are_where_the_table_says() -> None:
    import guided_gym

    for name in guided_gym.__all__:
        assert getattr(guided_gym, name) is not None


def test_no_module_is_a_cellar() -> None:
    cellars = {"utils", "util", "helpers", "misc", "common"}
    assert [name for _, name, _ in MODULES if name.split(".")[-1].strip("_") in cellars] == []


# Modules that are called otherwise than what installs them.
MODULE_OF = {"pillow": "PIL", "pyyaml": "yaml", "pycollada": "collada", "scikit-fmm": "skfmm"}
# What is needed and imported by others, or run as a program.
UNSEEN = {
    "pycollada": "trimesh reads a mesh format of URDF files by it",
    "tensorboard": "torch writes its files by it",
    "types-pyyaml": "mypy reads it",
    "ruff": "a program",
    "mypy": "a program",
    "pytest-timeout": "an option of pytest",
    "pytest-xdist": "an option of pytest",
    "mkdocs-material": "the theme of the site",
    "mkdocstrings": "a plugin of mkdocs",
}
FOR_DEVELOPERS = ("bench", "docs", "check", "dev")  # extras; tests and benchmarks may be all that uses them


def _wanted(file: Path) -> Iterator[str]:
    """Top-level modules that a file imports, or names in a call: ``import_module("toppra")``."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield (node.module or "").partition(".")[0]
        elif isinstance(node, ast.Call):
            texts = (a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str))
            yield from (text.partition(".")[0] for text in texts)


def _declared() -> dict[str, list[str]]:
    """The distributions of each extra; the package's own dependencies under an empty name."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needs = {"": project["dependencies"], **project["optional-dependencies"]}
    names = {extra: [re.split(r"[\[<>=,; ]", need)[0] for need in all_of] for extra, all_of in needs.items()}
    return {extra: [name for name in all_of if name != "guided-gym"] for extra, all_of in names.items()}


def _module(distribution: str) -> str:
    return MODULE_OF.get(distribution, distribution.replace("-", "_"))


def test_every_folder_of_the_package_is_installed() -> None:
    setuptools = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "setuptools"
    ]
    found = {
        ".".join([room, *file.parent.relative_to(REPOSITORY / folder).parts])
        for room, folder in setuptools["package-dir"].items()
        for file in (REPOSITORY / folder).rglob("__init__.py")
    }
    assert found == set(setuptools["packages"])


def test_every_dependency_is_used() -> None:
    package = {name for _, _, file in MODULES for name in _wanted(file)}
    folders = ("tests", "benchmarks", "faults", "docs", "examples")
    files = [file for folder in folders for file in (REPOSITORY / folder).rglob("*.py")]
    anywhere = package | {name for file in files for name in _wanted(file)}
    idle = [
        f"{distribution} ({extra or 'core'})"
        for extra, distributions in _declared().items()
        for distribution in distributions
        if distribution not in UNSEEN
        and _module(distribution) not in (anywhere if extra in FOR_DEVELOPERS else package)
    ]
    assert idle == []


def test_every_import_is_declared() -> None:
    modules = {extra: {_module(name) for name in names} for extra, names in _declared().items()}
    at_import = {*sys.stdlib_module_names, "guided_gym", "llvmlite", *modules[""]}  # llvmlite is numba's
    known = at_import.union(*modules.values())
    wrong = []
    for room, name, file in MODULES:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if not isinstance(node, ast.Import | ast.ImportFrom) or getattr(node, "level", 0):
                continue
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            # The core and the environments have to load without any extra.
            needed = at_import if room in ROOMS[:2] and node in tree.body else known
            wrong += [f"{name}: {one}" for one in names if one.partition(".")[0] not in needed]
    assert wrong == []


def test_functions_fit_on_a_screen() -> None:
    long = []
    for _, name, file in MODULES:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                lines = (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0
                if lines > LONGEST_FUNCTION:
                    long.append(f"{name}.{node.name}: {lines} lines")
    assert long == []


def test_import_is_light() -> None:
    code = f"""
        import sys
        import guided_gym
        print([name for name in {HEAVY!r} if name in sys.modules])
    """
    assert _run(code).strip() == "[]"


def test_import_registers_environments_without_loading_them() -> None:
    code = """
        import sys
        import gymnasium
        import guided_gym
        assert "guided_gym/TrapCup-v0" in gymnasium.registry, sorted(gymnasium.registry)
        print([name for name in sys.modules if name.startswith(("guided_gym.envs", "guided_gym.agents"))])
    """
    assert _run(code).strip() == "[]"


def test_make__in_a_folder_of_decoys(tmp_path: Path) -> None:
    """Other people's projects have a train.py, an agents.py and an envs folder; none of them may get in."""
    for decoy in ("train.py", "agents.py", "envs/__init__.py", "utils.py", "problems.py", "kernels.py"):
        (tmp_path / decoy).parent.mkdir(exist_ok=True)
        (tmp_path / decoy).write_text("raise RuntimeError('a file of the project was imported')\n")
    code = """
        import gymnasium as gym
        env = gym.make("guided_gym:guided_gym/TrapCup-v0")
        observation, info = env.reset(seed=0)
        observation, reward, terminated, truncated, info = env.step(0)
        print(type(env.unwrapped).__module__, reward <= 0.0)
    """
    assert _run(code, tmp_path).strip().startswith("guided_gym.envs")


def _run(code: str, folder: Path | None = None) -> str:
    """Output of a program run by a fresh interpreter, by default in the folder of this one."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout
