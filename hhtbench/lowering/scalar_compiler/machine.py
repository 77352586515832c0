"""From LLVM assembly to object code, and from object code to an address in this process."""

from __future__ import annotations

import ctypes
import threading
from functools import cache
from typing import Any

import llvmlite  # type: ignore[import-untyped]
import llvmlite.binding as llvm  # type: ignore[import-untyped]

LEVEL = 1  # of code generation: 2 and 3 take half as long again for code of the same speed
PLAIN_LOOPS = "-disable-lsr"  # loops keep the indices they are written with: two fifths of the time, and a tenth faster code
LONG = 20_000  # operations from which it is level 0, where 37,000 take 0.7 s instead of 13 s and run half as fast
_lock = threading.RLock()  # LLVM's global context is one for all threads
_loaded: list[Any] = []  # engines own the code: they live as long as the process


@cache
def start() -> None:
    """Prepare LLVM for this machine."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


@cache
def _keep_loops() -> None:
    """Set LLVM's option, which it takes once a process."""
    llvm.set_option("hhtbench", PLAIN_LOOPS)


def host() -> str:
    """Text on processor, features and versions, on which object code depends."""
    features = llvm.get_host_cpu_features().flatten()
    versions = f"{llvmlite.__version__} {llvm.llvm_version_info}"
    return f"{versions} {llvm.get_default_triple()} {llvm.get_host_cpu_name()} {features}"


def _target_machine(level: int = LEVEL) -> Any:
    options = {"opt": level, "reloc": "pic", "codemodel": "jitdefault", "jit": True}
    processor = {"cpu": llvm.get_host_cpu_name(), "features": llvm.get_host_cpu_features().flatten()}
    return llvm.Target.from_default_triple().create_target_machine(**processor, **options)


def generate(text: str, helpers: str, operations: int) -> bytes:
    """Object code of straight-line assembly and of the functions with loops that it calls.

    Straight lines go through no optimisation: the scalar graph has had all that pays, and what is left (SLP vectors) took
    nine tenths of the time and made Andrews' matrix slower.
    """
    with _lock:
        start()
        _keep_loops()
        machine = _target_machine(LEVEL if operations <= LONG else 0)
        module = _parsed(text, machine)
        if helpers:
            loops = _parsed(helpers, machine)
            builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
            builder.getModulePassManager().run(loops, builder)
            module.link_in(loops)
        return bytes(machine.emit_object(module))


def from_bitcode(bitcode: bytes, triple: str | None = None) -> bytes:
    """Object code of optimised bitcode for the platform ``triple`` (None: this one), for no processor in particular."""
    with _lock:
        start()
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
        triple = triple or llvm.get_default_triple()
        machine = llvm.Target.from_triple(triple).create_target_machine(opt=3, reloc="pic", codemodel="jitdefault", jit=True)
        module = llvm.parse_bitcode(bitcode)
        module.triple, module.data_layout = triple, str(machine.target_data)
        return bytes(machine.emit_object(module))


def _parsed(text: str, machine: Any) -> Any:
    module = llvm.parse_assembly(text)
    module.triple = llvm.get_default_triple()
    module.data_layout = str(machine.target_data)
    module.verify()
    return module


def load(code: bytes, *names: str) -> tuple[int, ...]:
    """Addresses of the functions ``names`` of object code, loaded for the rest of the process."""
    with _lock:
        start()
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        addresses = tuple(engine.get_function_address(name) for name in names)
        if not all(addresses):
            raise RuntimeError(f"object code without {names}")
        _loaded.append(engine)
        return addresses


def caller(address: int) -> Any:
    """Python callable of a C function of one pointer; holds the GIL, as calls take microseconds."""
    return ctypes.PYFUNCTYPE(None, ctypes.c_void_p)(address)
