"""Names that a library may change in any release are used in one named file, and the library is bounded for them."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("hhtbench", "solvers", "problems", "tests")
UNSTABLE = ("jax.extend", "jax.interpreters", "numba.core", "numba.np")  # without an underscore, and yet not stable
FILES = {
    "jax": {"hhtbench/lowering/jax_internals.py"},
    "numba": {"hhtbench/lowering/compile/compiled_loops.py", "solvers/kernel/intrinsics.py"},
    "numpy": {"hhtbench/runtime/processes.py"},
    "scipy": {"hhtbench/lowering/dynamics/differences.py"},
}


def _imported(tree: ast.AST) -> Iterator[str]:
    """Dotted names of import statements, and those in strings: modules are looked up by them too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and re.fullmatch(r"\w+(\.\w+)+", node.value):
            yield node.value


def _uses() -> Iterator[tuple[str, str]]:
    """Library and file of every private name that is imported."""
    for folder in FOLDERS:
        for file in (ROOT / folder).rglob("*.py"):
            if file == Path(__file__):
                continue
            for name in _imported(ast.parse(file.read_bytes())):
                library = name.partition(".")[0]
                private = "._" in name or name.startswith(UNSTABLE)
                if private and library not in FOLDERS and not name.startswith("_"):
                    yield library, file.relative_to(ROOT).as_posix()


def test_private_names_of_a_library_are_used_in_the_files_that_are_named_for_it():
    used: dict[str, set[str]] = {}
    for library, file in _uses():
        used.setdefault(library, set()).add(file)
    assert used == FILES


def test_a_library_whose_private_names_are_used_has_an_upper_bound():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["dev"]]
    bounded = {re.match(r"[\w-]+", line).group() for line in wanted if re.search(r"<|==", line)}
    assert {*FILES, "llvmlite", "scikit-sundae"} <= bounded
