"""``--reference auto``: certify a problem without known solution before its solvers are compared.

Two method families on two forms must agree, as for the library's references; their difference is the reference's error bar.
Nothing is certified twice: the file's name is a digest of what the result depends on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, as_completed
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.campaign.reference.certify import UnknownJumpError, certify
from hhtbench.campaign.reference.files import read_certificate, write_certificate
from hhtbench.campaign.reference.plan import Entry
from hhtbench.catalogue.registry import load_problem
from hhtbench.lowering.equations import Equations
from hhtbench.lowering.rates import fastest_rates
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import declared
from hhtbench.runtime.processes import Inline, worker_processes

GRID = 40  # equal pieces of the interval; the reference has a row at each end
SECONDS = 120.0  # default limit of each solve
RTOL = 1e-11  # tolerance of all methods but the explicit one: with so many steps they gain nothing from a smaller one
GGL, INDEX1 = "collocation(form=ggl)", "collocation(form=index1)"
EXPLICIT, IDA, CVODE = "projected(method=DOP853)", "ida(form=index1)", "cvode(form=ode, method=bdf)"
MAX_DECAY = 1e5  # decay times of the fastest mode in the interval, above which an implicit method is tried first
CHAOS = ". A shorter span may have a reference: of chaotic motion nobody knows a long one"  #: where methods arrive apart


def certified(
    specs: Mapping[str, str], folder: Path, jobs: int, tell: Callable[[str], None], seconds: float = SECONDS
) -> tuple[dict[str, Path], dict[str, str]]:
    """Certify problems; return spec -> certificate file in ``folder``, and spec -> reason for those without one.

    ``specs`` maps each spec to the digest of what it depends on.  Problems with a closed solution or a reference of their
    own are left out.  A solve may take ``seconds`` [s].  With ``jobs`` 0 all is solved in this process.
    """
    files = {spec: file_of(digest, folder) for spec, digest in specs.items()}
    missing = [spec for spec, file in files.items() if not file.is_file()]
    refused: dict[str, str] = {}
    if missing:
        folder.mkdir(parents=True, exist_ok=True)
        with worker_processes(min(jobs, len(missing))) if jobs else Inline() as pool:
            waiting: dict[Future[str], str] = {
                pool.submit(certify_one, spec, files[spec], seconds): spec for spec in missing
            }
            for done in as_completed(waiting):
                try:
                    why = done.result()
                except Exception as error:  # noqa: BLE001 - a user's problem, or the end of its process: the others go on
                    why = f"not certified: {type(error).__name__}: {error}"
                if why:
                    refused[waiting[done]] = why
                if why != KNOWN:
                    tell(f"reference of {waiting[done]}: {why or 'certified'}")
    return {spec: file for spec, file in files.items() if file.is_file()}, refused


def file_of(digest: str, folder: Path) -> Path:
    """Return the certificate's file for a ``digest`` of what it depends on."""
    return folder / f"{digest[:16]}.json"


KNOWN = "the problem brings its own"  #: reason of :func:`certify_one` for problems whose truth is known


def certify_one(spec: str, file: Path, seconds: float = SECONDS) -> str:
    """Write the certificate of ``spec`` to ``file``; return "" or the reason why there is none."""
    try:
        problem = load_problem(spec)
    except (ProblemError, TypeError) as error:
        return f"it cannot be loaded: {error}"
    if problem.exact is not None or problem.reference is not None:
        return KNOWN
    reasons, apart = [], False
    for first, second in methods_for(problem):
        tight = {"rtol": RTOL} | ({} if second == (EXPLICIT,) else {"second_rtol": RTOL})
        asked: dict[str, Any] = {"times": (problem.t_span[1],), "grid": GRID, "seconds": seconds} | tight
        entry = Entry(name=file.stem, spec=spec, first=first, second=second, **asked)
        try:
            found = certify(entry)
        except UnknownJumpError as error:
            return f"not certified: {error}"
        except Exception as error:  # noqa: BLE001 - a user's functions, or the solver's: the next pair may take them
            reasons.append(f"{first}: {type(error).__name__}: {error}")  # without notes: JAX adds one of its own
            continue
        if found.certified:
            write_certificate(found, file.parent)
            return ""
        apart |= any(other.confirms for other in found.confirmations)
        ended = ", ".join(f"{other.solver} {other.status}" for other in found.confirmations if other.independent)
        reasons.append(f"{first} and {' and '.join(second)} do not agree to 1e-5 ({ended})")
    return f"not certified: {'; '.join(dict.fromkeys(reasons)).rstrip('.')}{CHAOS if apart else ''}"


def methods_for(problem: Problem) -> list[tuple[str, tuple[str, ...]]]:
    """Return pairs of first and second solvers to try in order, of two method families on two forms."""
    constrained = any(declared(problem.system, name) is not None for name in ("constraint", "velocity_constraint"))
    first = GGL if constrained else INDEX1  # without constraints there is no ggl
    explicit = [(form, (EXPLICIT,)) for form in dict.fromkeys((first, INDEX1))]
    implicit = (first, (CVODE, IDA) if constrained else (CVODE,))
    order = [implicit, *explicit] if _decays(problem) else [*explicit, implicit]
    return [*order, (EXPLICIT, (IDA,))]


def _decays(problem: Problem) -> bool:
    """True if a mode decays more than ``MAX_DECAY`` times in the interval, estimated at the start."""
    with suppress(Exception):  # a user's functions: what is wrong with them the solvers say
        equations, (t0, t1) = Equations(problem), problem.t_span
        rates = fastest_rates(equations, equations.acceleration(t0, problem.q0, problem.v0))
        return rates.decay * abs(t1 - t0) > MAX_DECAY
    return False


def reference_of(file: Path) -> dict[str, Any]:
    """Read a certificate as the ``reference`` of a :class:`~hhtbench.Problem`."""
    stored = read_certificate(file)
    count = stored["t"].size
    values = {key: stored["values"].get(key, np.zeros((count, 0))) for key in ("q", "v", "lam", "mu")}
    worst = max(float(stored["bars"][key].max()) for key in ("q", "v"))
    others = [other["solver"] for other in stored["confirmed_by"] if other["independent"] and other["status"] == "success"]
    source = f"{stored['first']}, confirmed by {' and '.join(others)}"
    if jumps := stored.get("jumps"):
        source += f", across the jumps of prescribed velocities at t = {', '.join(f'{t:.9g}' for t in jumps)}"
    return {"t": stored["t"], **values, "bars": stored["bars"], "digits": int(-np.log10(worst)), "source": source}
