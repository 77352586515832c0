"""What a user installs: a source distribution, the wheel that is built from it, and README's crane run from the wheel."""

from __future__ import annotations

import re
import shutil
import site
import subprocess
import sys
import tarfile
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
SOURCES = ("hhtbench", "solvers", "problems", "pyproject.toml", "README.md", "LICENSE")
EXAMPLE = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)[1]  # type: ignore[index]


def build(folder: Path, kind: str, into: Path) -> Path:
    """A distribution of the sources in ``folder``, made by the declared build backend."""
    code = f"from setuptools import build_meta; print(build_meta.build_{kind}({str(into)!r}))"
    found = subprocess.run([sys.executable, "-c", code], cwd=folder, check=True, capture_output=True, text=True)
    return into / found.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def distributions(tmp_path_factory) -> tuple[Path, Path]:
    """The source distribution, and the wheel built from it alone."""
    folder = tmp_path_factory.mktemp("packaging")
    (folder / "sources").mkdir()
    for name in SOURCES:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, folder / "sources" / name)
    source = build(folder / "sources", "sdist", folder)
    with tarfile.open(source) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    (unpacked,) = (folder / "unpacked").iterdir()
    return source, build(unpacked, "wheel", folder)


def run_crane(python: Path, folder: Path) -> str:
    """What README's example prints with an installed hhtbench, away from the sources."""
    (folder / "crane.py").write_text(EXAMPLE + "import solvers.hht\nprint(hb.__file__, solvers.hht.__file__)\n")
    found = subprocess.run([python, "crane.py"], cwd=folder, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    return found.stdout


def test_the_wheel_of_the_source_distribution_runs_the_crane(distributions, tmp_path):
    """In an environment of its own, which borrows the libraries, and not hhtbench, from this one."""
    venv.create(tmp_path / "env", with_pip=False)
    python = tmp_path / "env/bin/python"
    packages = next((tmp_path / "env/lib").glob("python*/site-packages"))
    options = ["--quiet", "--no-deps", "--no-index", "--disable-pip-version-check", "--target", packages]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, distributions[1]], check=True, capture_output=True)
    (packages / "libraries.pth").write_text("\n".join(site.getsitepackages()))
    printed = run_crane(python, tmp_path)
    assert "success" in printed
    assert printed.count(str(packages)) == 2
    command = [python, "-c", "from hhtbench.cli.main import main; main()", "list"]
    listed = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    assert "andrews" in listed.stdout


@pytest.mark.long
def test_the_wheel_installs_with_its_dependencies_alone_and_passes_twine(distributions, tmp_path):
    """From the package registry into an empty environment; a minute or two."""
    venv.create(tmp_path / "env", with_pip=True)
    python = tmp_path / "env/bin/python"
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, distributions[1]], check=True)
    assert "success" in run_crane(python, tmp_path)
    subprocess.run([*pip, "twine"], check=True)
    command = [python, "-m", "twine", "check", "--strict", *distributions]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout
