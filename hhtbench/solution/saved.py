"""Save and load records of arrays as ``.npz`` files without pickled code."""

from __future__ import annotations

import enum
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.protocol.errors import ProblemError

TREE = "tree"  # the text: how the values nest; an array in it is {"array": its name in the file}


def write_arrays(path: str | Path, values: Mapping[str, Any]) -> Path:
    """Write numbers, strings, arrays, enum members, records, and tuples or mappings of them to an ``.npz`` file.

    ``.npz`` is added to the name where it is missing.  Returns the path.
    """
    file = Path(path)
    file = file if file.suffix == ".npz" else file.with_name(file.name + ".npz")
    arrays: dict[str, Any] = {}
    tree = {name: _plain(name, value, arrays) for name, value in values.items()}
    arrays[TREE] = json.dumps(tree)
    np.savez(file, **arrays)
    return file


def read_arrays(path: str | Path, kinds: tuple[type, ...]) -> dict[str, Any]:
    """Read the values that :func:`write_arrays` wrote; ``kinds`` are the record and enum classes among them."""
    try:
        with np.load(path, allow_pickle=False) as arrays:
            tree = json.loads(str(arrays[TREE][()]))
            return {name: _valued(value, arrays, {kind.__name__: kind for kind in kinds}) for name, value in tree.items()}
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError, zipfile.BadZipFile, EOFError) as broken:
        raise ProblemError(
            f"{path} holds no saved solution, or a damaged one; expected what Solution.save wrote."
        ) from broken


def _plain(name: str, value: Any, arrays: dict[str, Any]) -> Any:
    """Convert ``value`` to JSON types; its arrays go into ``arrays`` under keys that begin with ``name``."""
    if isinstance(value, enum.Enum):
        return {"record": type(value).__name__, "member": value.name}
    if is_dataclass(value) or hasattr(value, "_asdict"):
        parts = value._asdict() if hasattr(value, "_asdict") else {f.name: getattr(value, f.name) for f in fields(value)}
        return {"record": type(value).__name__, "parts": _plain(name, parts, arrays)["mapping"]}
    if isinstance(value, Mapping):
        return {"mapping": {key: _plain(f"{name}.{key}", part, arrays) for key, part in value.items()}}
    if isinstance(value, (tuple, list)):
        return {"tuple": [_plain(f"{name}.{i}", part, arrays) for i, part in enumerate(value)]}
    if isinstance(value, np.ndarray) or (isinstance(value, float) and not math.isfinite(value)):
        arrays[name] = value
        return {"array": name}
    return value.item() if isinstance(value, np.generic) else value


def _valued(value: Any, arrays: Any, kinds: Mapping[str, Any]) -> Any:
    """The inverse of :func:`_plain`."""
    if not isinstance(value, dict):
        return value
    if "array" in value:
        found = arrays[value["array"]]
        return found if found.ndim else float(found)
    if "member" in value:
        return kinds[value["record"]][value["member"]]
    if "tuple" in value:
        return tuple(_valued(part, arrays, kinds) for part in value["tuple"])
    parts = {name: _valued(part, arrays, kinds) for name, part in (value.get("parts") or value["mapping"]).items()}
    return kinds[value["record"]](**parts) if "record" in value else parts
