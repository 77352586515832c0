"""Disks that fail or lose power, clocks that jump: processes with ``faulty_files.c`` preloaded, the replay of its record."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

import pytest

SOURCE = Path(__file__).with_name("faulty_files.c")
SECTOR = 512  # bytes that a disk writes as a whole


def preloaded(folder: Path) -> Path:
    """The library, compiled into ``folder``."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    library = folder / "faulty_files.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(SOURCE)], check=True)
    return library


def environment(library: Path, **settings: object) -> dict[str, str]:
    """For a process whose files, or clock, are faulty: ``files=``, ``log=``, ``after=``, ``errno=``, ``clock=``."""
    given = {f"FAULTY_{name.upper()}": str(value) for name, value in settings.items()}
    return {**os.environ, "LD_PRELOAD": str(library), **given}


@dataclass(frozen=True)
class Change:
    """One thing that the disk was told: (c)reate, (w)rite, (t)runcate, (s)ynchronise, (u)nlink."""

    what: str
    name: str  #: what follows the store's name, "" of the store itself; "/" of its folder
    offset: int
    size: int
    data: bytes


def read_changes(log: Path) -> list[Change]:
    """The record, in order."""
    content, place, found = log.read_bytes(), 0, []
    while place < len(content):
        end = content.index(b"\n", place)
        what, name, offset, size, held = content[place:end].decode().split()
        place = end + 1 + int(held)
        data = content[end + 1 : place]
        found.append(Change(what, "" if name == "." else name, int(offset), int(size), data))
    return found


@dataclass
class _File:
    durable: bytes = b""
    pending: list[Change] = field(default_factory=list)


def after_power_loss(changes: Sequence[Change], chance: Random | None) -> dict[str, bytes]:
    """Contents of the files by name: what was synchronised, and of the rest what ``chance`` lets through, None: nothing.

    Of a write any sectors may have come through.  That a file is there, or no longer, is on the disk once its folder is
    synchronised.
    """
    files: dict[str, _File] = {}
    there: dict[str, _File] = {}  # as the folder on the disk has it
    for change in changes:
        if change.what == "c":
            files[change.name] = _File()
        elif change.what == "u":
            files.pop(change.name, None)
        elif change.name == "/":
            there = dict(files)
        elif change.what == "s":
            file = files[change.name]
            file.durable, file.pending = _content(file, lambda _: True), []
        else:
            files[change.name].pending.append(change)
    if chance is not None and chance.random() < 0.5:
        there = files
    return {name: _content(file, lambda _: chance is not None and chance.random() < 0.5) for name, file in there.items()}


def _content(file: _File, through) -> bytes:  # type: ignore[no-untyped-def]
    content = bytearray(file.durable)
    for change in file.pending:
        if change.what == "t":
            if through(change):
                del content[change.size :]
                content.extend(bytes(change.size - len(content)))
            continue
        for begin, part in _sectors(change):
            if through(change):
                content.extend(bytes(max(0, begin + len(part) - len(content))))
                content[begin : begin + len(part)] = part
    return bytes(content)


def _sectors(change: Change) -> Iterator[tuple[int, bytes]]:
    for begin in range(0, len(change.data), SECTOR):
        yield change.offset + begin, change.data[begin : begin + SECTOR]
